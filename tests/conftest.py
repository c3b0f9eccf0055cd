"""What all tests share."""

from hypothesis import HealthCheck, settings

# Machines are noisy, and some have much else to do: no test fails by the clock.
settings.register_profile("occmap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("occmap")
