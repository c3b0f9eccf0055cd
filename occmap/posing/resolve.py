"""Resolution: the way from the map to the frame of a scan, and whose poses it follows."""

from dataclasses import dataclass, field, replace
from typing import TypeAlias

from occmap.errors import MountError, PoseError
from occmap.posing.chain import Chain, make_chain
from occmap.posing.frames import FIXED_NAMES, Edge, FrameTree, Source, find_moving, last_part
from occmap.posing.options import PosingOptions
from occmap.posing.sources import Sources
from occmap.posing.tracks import Track
from occmap.report.words import join_names

GIVE_POSES = "give a trajectory: `poses=FILE`"
Way: TypeAlias = tuple[str, list[Edge]]
"""A fixed frame, and the steps from it to the sensor."""


def resolve(
    sources: Sources,
    options: PosingOptions,
    frame: str,
    fixed: str | None = None,
    alone: bool = True,
) -> tuple[str, Chain, list[str]]:
    """Find the way to a scan's frame.

    Where the user names a trajectory, it carries the scans. Else the tree of tf does, which
    odometry fills where tf says nothing; else, where nothing in the tree moves, a topic of poses.

    Parameters
    ----------
    sources, options
        What the log knows and what the user chose.
    frame
        The scan's.
    fixed
        The frame that other scans are mapped in already.
    alone
        No other laser of the log is mapped.

    Returns
    -------
    fixed, chain, notes
        The frame that its scans are mapped in, the way from there, and what a user should know of
        how it was chosen.

    Raises
    ------
    PoseError
        There is no way; says what is missing, and which option mends it.
    """
    search = _Search(sources, options, frame.strip("/"), alone)
    poses = sources.trajectory or (None if sources.tree.frames else sources.unnamed_body)
    name, steps = search.go_by_poses(poses) if poses else search.go_by_tree(fixed)
    if fixed is not None and name != fixed:
        found = f"{frame!r} maps in {name!r} while other scans map in {fixed!r}"
        fix = f"join the two: `static_transforms={fixed},{name},X,Y,Z,ROLL,PITCH,YAW`"
        raise PoseError(found, fix=fix)
    return name, make_chain(steps, options.max_pose_gap_s), search.notes


@dataclass(slots=True)
class _Search:
    """The search for one frame's way; gathers notes as it decides.

    A way leads down to the anchor. That is the scan's frame or, where the user gives the sensor's
    pose, the body that the sensor is on; one more step then leads from there to the sensor.
    """

    sources: Sources
    options: PosingOptions
    frame: str
    alone: bool
    """No other laser of the log is mapped."""
    notes: list[str] = field(default_factory=list)

    @property
    def tree(self) -> FrameTree:
        """The frames of the log."""
        return self.sources.tree

    @property
    def known(self) -> str:
        """Their names, for errors, and the transforms between them that are damaged."""
        return "; ".join([f"known: {join_names(self.tree.frames)}", *self.sources.unusable])

    def go_by_tree(self, fixed: str | None) -> Way:
        """Go by the tree; where nothing in it moves, by a topic of poses."""
        if not self.tree.frames:
            sought = "looked for tf, odometry and topics of poses in the log"
            raise PoseError(f"the scans have no poses: {sought}", fix=GIVE_POSES)
        anchor = self._find_base() if self.options.sensor_pose else self.frame
        if anchor not in self.tree:
            raise self._miss_mount()
        usual = self.tree.choose_fixed(anchor)
        if not find_moving(self._find_path(usual, anchor)):
            if self.sources.unnamed_body:
                return self.go_by_poses(self.sources.unnamed_body)
            if not (self.options.map_frame or fixed or last_part(usual) in FIXED_NAMES):
                raise self._miss_motion(usual)
        name = self.options.map_frame or fixed or usual
        steps = self._find_path(name, anchor)
        self.notes += [
            f"tf does not give {step.parent} -> {step.child}: taken from {step.topic}"
            for step in steps
            if step.source is Source.ODOMETRY
        ]
        if self.options.base_frame and not self.options.sensor_pose:
            self.notes.append("`base_frame` does nothing: it is for `sensor_pose` and `poses`")
        return name, [*steps, *self._mount_on(anchor)]

    def go_by_poses(self, trajectory: Edge) -> Way:
        """Go by the poses of one body, and from there down to the sensor."""
        base = self.options.base_frame
        body = trajectory.child or base or self._guess_body()
        anchor = (base or body) if self.options.sensor_pose else self.frame
        if anchor != body and anchor not in self.tree:
            raise self._miss_mount()
        if base and self.tree.find_path(body, anchor) is None:
            body = base
        fixed = self.options.map_frame or trajectory.parent
        above = self._find_path(fixed, trajectory.parent)
        below = self._find_path(body, anchor)
        note = f"poses from {trajectory.topic}, taken as those of {body!r}"
        if body == self.frame and not trajectory.child:
            mount = f"`sensor_pose=({MountError.UNKNOWN})`"
            note += f", the laser itself: give {mount} if they are the robot's"
        self.notes.append(note)
        carried = replace(trajectory, child=body)
        return fixed, [*above, carried, *below, *self._mount_on(anchor)]

    def _guess_body(self) -> str:
        """Guess whose poses a trajectory holds: the laser's own if tf does not know its frame."""
        if self.frame in self.tree:
            return self.tree.find_body(self.frame)
        if not self.options.sensor_pose:
            return self.frame
        bases = self.tree.list_bases(self.frame)
        return bases[0] if len(bases) == 1 else "base_link"

    def _find_base(self) -> str:
        """Find the frame that the given sensor pose is measured from."""
        wanted = self.options.base_frame
        if wanted and wanted not in self.tree:
            fix = f"`base_frame` takes {join_names(self.tree.frames)}"
            raise PoseError(f"no frame {wanted!r} in the log", fix=fix)
        bases = [wanted] if wanted else self.tree.list_bases(self.frame)
        if len(bases) == 1:
            return bases[0]
        found = f"which frame the laser is mounted on is not clear ({self.known})"
        raise PoseError(found, fix=f"name it: `base_frame={bases[0] if bases else 'FRAME'}`")

    def _mount_on(self, anchor: str) -> list[Edge]:
        """Make the step from the body to a sensor whose pose the user gave."""
        if self.options.sensor_pose is None:
            return []
        if self.frame in self.tree:
            self.notes.append(f"the given sensor pose replaces the log's of {self.frame!r}")
        track = Track.fixed(self.options.sensor_pose)
        return [Edge(anchor, self.frame, track, Source.GIVEN)]

    def _find_path(self, upper: str, lower: str) -> list[Edge]:
        """Find the steps down from one frame to another; raises PoseError where there are none."""
        if upper == lower:
            return []
        steps = self.tree.find_path(upper, lower)
        if steps is not None:
            return steps
        if upper not in self.tree:
            is_given = upper == self.options.map_frame
            fix = "give one of these as `map_frame`, or leave it out" if is_given else ""
            raise PoseError(f"no frame {upper!r} in the log ({self.known})", fix=fix)
        found = f"no transform from {upper!r} to {lower!r} ({self.known})"
        fix = f"give it: `static_transforms={upper},{lower},X,Y,Z,ROLL,PITCH,YAW`"
        raise PoseError(found, fix=fix)

    def _miss_mount(self) -> PoseError:
        """Say that nothing tells where the laser sits, and how to give that."""
        found = f"no transform to the laser's frame {self.frame!r} ({self.known})"
        bases = self.tree.list_bases(self.frame)
        base = bases[0] if len(bases) == 1 else ""
        mount = f"`sensor_pose=({MountError.UNKNOWN})`"
        if not self.alone:  # a sensor pose would be that of every laser
            given = f"{base or 'BASE'},{self.frame},X,Y,Z,ROLL,PITCH,YAW"
            return PoseError(found, fix=f"give its mount: `static_transforms={given}`")
        if not base:
            return PoseError(found, fix=f"give its mount: {mount} `base_frame=FRAME`")
        return MountError(found, fix=f"give its mount on {base}: {mount}")

    def _miss_motion(self, root: str) -> PoseError:
        """Say that nothing moves on the way from a root to the laser, and how to mend that."""
        if bodies := self.tree.bodies:
            found = f"the laser's frame {self.frame!r} hangs on {root!r}, which is not connected to"
            fix = f"join them: `static_transforms={bodies[0]},{root},0,0,0,0,0,0`"
            return PoseError(f"{found} what moves: {join_names(bodies)}", fix=fix)
        found = f"the scans have no poses: tf only says where {self.frame!r} sits on {root!r}, and"
        return PoseError(f"{found} the log has no odometry and no topic of poses", fix=GIVE_POSES)
