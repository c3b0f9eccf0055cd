"""From recorded poses to the pose of each scan.

A pose sample, such as a message on /tf, goes this way:

1. `sources.gather` sorts all samples of a log by topic and frames. Those of one frame in another
   become a `Track` (`tracks`), in the order of time, and with its frames an `Edge`.
2. A `FrameTree` (`frames`) chooses between edges that contradict each other, and knows the ways
   from frame to frame. A trajectory that the user gives (`trajectory`) is an edge beside it.

A batch of scans goes this way, all of it in `attach.Poser.attach`:

3. `resolve` finds the way through the tree, from the frame of the map to that of the scans.
4. `chain` makes a `Chain` of it, and interpolates that at the stamps of the scans.
5. `attach` leaves out scans without a pose, and `deskewing` gives each beam one of its own where
   that is wanted.
6. `leaps` leaves out scans whose poses leap away and back.
7. `course` and `jumps` watch where the sensor goes, and say what of that spoils a map.

`options` has what the user chooses on the way, and `rotations` the mathematics.
"""
