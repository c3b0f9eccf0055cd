"""What the poses that scans were given show: how sensors sat, and what of that spoils a map."""

from collections import defaultdict
from collections.abc import Iterator

from occmap.posing.chain import Chain, make_chain
from occmap.posing.concerns import Concern
from occmap.posing.course import STANDS, Course, list_tilts
from occmap.posing.frames import Edge, Source, Step
from occmap.posing.jumps import JumpWatch
from occmap.posing.options import Stamps
from occmap.posing.tracks import TrackBuilder
from occmap.types import Int64, PoseBatch, PosedScans


class Watch:
    """Watches the poses of the scans of one log; grows with the scans that it is shown."""

    def __init__(self) -> None:
        self.courses: defaultdict[str, Course] = defaultdict(Course)
        """By topic: how its sensor sat, and where it went."""
        self._jumps: dict[str, JumpWatch] = {}
        """By scan frame: what its chain does"""
        self._stated: defaultdict[str, TrackBuilder] = defaultdict(TrackBuilder)
        """By topic: the poses that stand beside its scans"""

    def see(self, scans: PosedScans, stamp_ns: Int64, chain: Chain | None) -> None:
        """Record where the sensor was.

        Parameters
        ----------
        stamp_ns
            (S,) of the scans, by the clock of the poses.
        chain
            What their poses were looked up in; None where they stand beside the scans.
        """
        frame, topic, pose = scans.batch.frame, scans.batch.topic, scans.batch.pose
        self.courses[topic].see(scans)
        if chain is not None:
            if frame not in self._jumps:
                self._jumps[frame] = JumpWatch(chain)
            self._jumps[frame].see(stamp_ns)
        elif pose is not None:
            stated = PoseBatch(stamp_ns, stamp_ns, pose, "", "", static=False, topic=topic)
            self._stated[topic].add_batch(stated, Stamps.HEADER)

    def _list_jumps(self) -> dict[str, JumpWatch]:
        """List the jumps by topic; in poses beside scans they show only once all are there."""
        watches = {
            topic: self._jumps[course.frame]
            for topic, course in self.courses.items()
            if course.frame in self._jumps
        }
        for topic, builder in self._stated.items():
            track = builder.build()
            if track is not None:
                watch = JumpWatch(make_chain([Step(Edge("", "", track, Source.ODOMETRY))], None))
                watch.see(track.stamp_ns)
                watches[topic] = watch
        return watches

    @property
    def jumps(self) -> bool:
        """Whether any pose takes the robot elsewhere at once."""
        return any(watch.edges_ns.size for watch in self._list_jumps().values())

    def list_notes(self) -> Iterator[str]:
        """Say which sensors never moved."""
        for topic, course in sorted(self.courses.items()):
            if course.stands:
                yield f"{topic}: {STANDS}"

    def list_concerns(self, first_ns: int, max_range: float) -> Iterator[tuple[str, Concern]]:
        """Say what spoils a map, and of which topic.

        Parameters
        ----------
        first_ns
            Stamp of the first scan of the log, by the clock of the poses.
        max_range
            Beams are used up to here (m).
        """
        jumped, watches = False, self._list_jumps()
        for topic, course in sorted(self.courses.items()):
            if course.stance:
                yield from ((topic, tilt) for tilt in list_tilts(course.stance, max_range))
            watch = watches.get(topic)
            if watch and not jumped:  # of several sensors on one robot, one tells it
                for concern in watch.list_concerns(first_ns):
                    jumped = True
                    yield topic, concern
