"""A motion: joint positions over time, straight lines between the samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector, as_array, as_count, as_number
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.machine import JointLimits

SAMPLE_PERIOD = 0.02  # s between the samples of a planned motion; chosen
_LONG = 0.025  # rad or m of a joint between two moments at which limits are checked: finds peaks of flow within 0.1 %
_MOST = 200_000  # moments of one motion; chosen, so that checking a very long one takes seconds


@dataclass(frozen=True, eq=False)
class Moments:
    """M moments of a motion, in order: its samples, and further ones inside its long segments.

    Attributes
    ----------
    time: (M,) [s].
    q, v, a: (M, n); at a sample a is that of `Trajectory.corner_accelerations`. Inside a segment v is constant, and
        a is between those at its ends if the samples are those of a smooth motion, 0 if they are far apart.
    before, after: (M, n) the velocities before and after a corner; v where the samples are
        those of a smooth motion.
    segment: (M,) index of the segment that begins or continues there; for the last sample, the sample's own index.
    """

    time: Vector
    q: Matrix
    v: Matrix
    a: Matrix
    before: Matrix
    after: Matrix
    segment: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Beside:
    """The segment before or after a part of a motion.

    Attributes
    ----------
    velocity: (n,) of the joints on it [rad/s or m/s].
    span: how long it takes [s].
    """

    velocity: Vector
    span: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a motion, between which the joints move linearly in time.

    Attributes
    ----------
    time: (T,) strictly increasing, starting at 0 [s].
    q: (T, n) joint positions [rad or m].
    v: (T, n) joint velocities at the samples [rad/s or m/s]: the mean of the
        velocities before and after, 0 at both ends of a motion from rest to rest.
    begins: for a sequence, the first sample of each leg that the motion has begun, from 0; otherwise empty.
    before, after: for a part of a motion, the segments beside it; None if the part begins or ends at rest.
    """

    time: Vector
    q: Matrix
    v: Matrix
    begins: tuple[int, ...] = ()
    before: Beside | None = None
    after: Beside | None = None

    def __post_init__(self) -> None:
        for name, axes in (("time", 1), ("q", 2), ("v", 2)):
            values = as_array(getattr(self, name), *[None] * axes, key=f"trajectory.{name}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if len(self.time) == 0:
            raise InputError("a trajectory needs at least one sample", key="trajectory.time")
        if len(self.q) != len(self.time) or self.v.shape != self.q.shape:
            raise InputError(
                "the samples do not fit together",
                key="trajectory",
                found=f"time {self.time.shape}, q {self.q.shape}, v {self.v.shape}",
                allowed="(T,), (T, n), (T, n)",
            )
        if self.time[0] != 0.0:
            raise InputError("does not start at 0", key="trajectory.time", found=float(self.time[0]))
        if np.any(np.diff(self.time) <= 0.0):
            raise InputError("does not increase", key="trajectory.time")
        object.__setattr__(self, "begins", self._checked_begins())
        for name in ("before", "after"):
            if getattr(self, name) is not None:
                check_kind(getattr(self, name), Beside, key=f"trajectory.{name}")

    def __repr__(self) -> str:
        """One line: samples, joints and duration."""
        return f"<Trajectory: {len(self)} samples of {self.q.shape[1]} joints, {self.duration:.2f} s>"

    def _checked_begins(self) -> tuple[int, ...]:
        begins = tuple(
            as_count(first, key=f"trajectory.begins[{index}]")
            for index, first in enumerate(check_kind(self.begins, Iterable, key="trajectory.begins"))  # type: ignore[type-abstract]
        )
        if begins and not (begins[0] == 0 and list(begins) == sorted(set(begins)) and begins[-1] < len(self)):
            raise InputError(
                "is not the first sample of each leg", key="trajectory.begins", found=list(begins),
                allowed=f"0, then ascending, less than {len(self)}",
            )  # fmt: skip
        return begins

    @classmethod
    def from_steps(cls, time: Vector, q: Matrix, *, begins: tuple[int, ...] = ()) -> Trajectory:
        """The motion through samples `q` (T, n) at `time` (T,), from rest to rest; for `begins` see `Trajectory`."""
        time = np.array(as_array(time, None, key="trajectory.time"))
        q = np.array(as_array(q, None, None, key="trajectory.q"))
        v = np.zeros_like(q)
        if len(time) > 2 and len(time) == len(q) and np.all(np.diff(time) > 0.0):
            segment = np.diff(q, axis=0) / np.diff(time)[:, None]
            v[1:-1] = 0.5 * (segment[:-1] + segment[1:])
        return cls(time=time, q=q, v=v, begins=begins)

    def part(self, first: int, last: int) -> Trajectory:
        """The motion from the sample `first` to `last`, on a clock of its own."""
        first, last = as_count(first, key="first"), as_count(last, key="last")
        for key, sample, low in (("first", first, 0), ("last", last, first)):
            if not low <= sample < len(self):
                raise InputError("is no sample of the part", key=key, found=sample, allowed=f"{low} to {len(self) - 1}")
        steps, velocity = np.diff(self.time), self.segment_velocities()
        return Trajectory(
            time=self.time[first : last + 1] - self.time[first],
            q=self.q[first : last + 1],
            v=self.v[first : last + 1],
            before=Beside(velocity[first - 1], float(steps[first - 1])) if first > 0 else self.before,
            after=Beside(velocity[last], float(steps[last])) if last < len(self) - 1 else self.after,
        )

    def own_velocities(self) -> Matrix:
        """(T, n) the velocities that belong to the samples: the mean of those before and after, 0 at rest."""
        if len(self) < 2:
            return self.v if self.before is not None or self.after is not None else np.zeros_like(self.q)
        around = np.vstack((self._velocity(self.before), self.segment_velocities(), self._velocity(self.after)))
        found = 0.5 * (around[:-1] + around[1:])
        for row, beside in ((0, self.before), (-1, self.after)):
            if beside is None:
                found[row] = 0.0
        return np.asarray(found)

    def _velocity(self, beside: Beside | None) -> Vector:
        """(n,) velocity of a segment beside the motion; 0 at rest."""
        return np.zeros(self.q.shape[1]) if beside is None else beside.velocity

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def __len__(self) -> int:
        return len(self.time)

    def at(self, time: float | Vector) -> Matrix:
        """(n,) joint positions at `time` [s], or (k, n) at (k,) times.

        The joints are at rest before the start and after the end.
        """
        if not isinstance(time, float) or time != time:
            time = as_array(time, key="time", finite=False)
        return np.stack([np.interp(time, self.time, column) for column in self.q.T], axis=-1)

    def segment_velocities(self) -> Matrix:
        """(T - 1, n) the constant velocity between neighbouring samples."""
        return np.asarray(np.diff(self.q, axis=0) / np.diff(self.time)[:, None])

    def moments(self, *, longest: float = _LONG) -> Moments:
        """The samples, and further moments between samples that are far apart.

        These make the use of a limit independent of how few samples there are. Most planned
        motions need no further moments. In a segment of more than two `SAMPLE_PERIOD` they are from where the corner
        before it is rounded off to where that behind it begins, however little the joints move: no joint accelerates
        in between, and what an acceleration takes at the samples may be less.

        Parameters
        ----------
        longest: the most that a joint moves from one moment to the next [rad or m]; infinite for the samples alone.
        """
        longest = as_number(longest, key="longest", above=0.0, finite=False)
        steps = np.max(np.abs(np.diff(self.q, axis=0)), axis=1, initial=0.0)
        parts = np.ceil(steps / longest)
        parts = np.maximum(np.ceil(parts * min(1.0, _MOST / max(float(np.sum(parts)), 1.0))), 1.0).astype(np.int64)
        last = len(self) - 1
        times = np.diff(self.time)
        straight = (times > 2.0 * SAMPLE_PERIOD) & (steps > 0.0) & np.isfinite(longest)
        rows = np.where(straight, parts + 2, parts)
        segment = np.repeat(np.arange(last), rows)
        first = np.cumsum(rows) - rows  # rows of the samples that begin a segment
        number = np.arange(len(segment)) - first[segment]
        rounded = 0.5 * SAMPLE_PERIOD / times[segment]
        inside = straight[segment] & (number > 0)
        part = np.where(
            inside, rounded + (number - 1) / parts[segment] * (1.0 - 2.0 * rounded), number / parts[segment]
        )
        velocities = self.segment_velocities()
        moving = velocities[segment]
        corner = np.append(first, len(segment))  # rows of the samples
        # the further apart the samples, the nearer a corner comes to the velocities beside it
        sharp = (1.0 - np.minimum(SAMPLE_PERIOD / self._spans(), 1.0))[:, None] if last else np.zeros((1, 1))
        beside = np.vstack((self._velocity(self.before), velocities, self._velocity(self.after)))
        found = [np.vstack((moving, moving[-1:] if last else self.v)) for _ in range(4)]
        accelerations = self.corner_accelerations()
        at_samples = (
            self.v, accelerations,
            self.v + sharp * (beside[:-1] - self.v), self.v + sharp * (beside[1:] - self.v),
        )  # fmt: skip
        # and the less of a segment is spent on rounding its corners off
        smooth = np.clip(2.0 - np.diff(self.time) / SAMPLE_PERIOD, 0.0, 1.0)[segment, None]
        along = part[:, None]
        found[1][:-1] = smooth * ((1.0 - along) * accelerations[segment] + along * accelerations[segment + 1])
        for values, of_samples in zip(found, at_samples, strict=True):
            values[corner] = of_samples
        v, a, before, after = found
        return Moments(
            time=np.append(self.time[segment] + part * np.diff(self.time)[segment], self.time[-1]),
            q=np.vstack((self.q[segment] + part[:, None] * np.diff(self.q, axis=0)[segment], self.q[-1:])),
            v=v,
            a=a,
            before=before,
            after=after,
            segment=np.append(segment, last),
        )

    def accelerations(self) -> Matrix:
        """(T, n) change of velocity at each sample over the half segments beside it.

        The motion starts and ends at rest: the first and the last row are the change
        from and to rest over one segment.
        """
        return np.asarray(self.velocity_changes() / self._spans()[:, None]) if len(self) > 1 else np.zeros_like(self.q)

    def corner_accelerations(self) -> Matrix:
        """(T, n) accelerations if every change of velocity takes at most `SAMPLE_PERIOD`; limits apply to these.

        Between samples the joints move linearly, so every sample is a corner at which the
        velocity jumps by some dv. A machine that follows the motion rounds the corner off: if the
        change is spread over a time T, the acceleration is dv / T, and the joint misses the corner
        by dv T / 8. Samples no further apart than `SAMPLE_PERIOD` are those of a smooth motion. Samples
        further apart may not be, however slowly they follow each other; if their corners are rounded
        off within `SAMPLE_PERIOD`, the joints miss them by no more than `chord_sagitta`.
        """
        if len(self) < 2:
            return np.zeros_like(self.q)
        return np.asarray(self.velocity_changes() / np.minimum(self._spans(), SAMPLE_PERIOD)[:, None])

    def velocity_changes(self) -> Matrix:
        """(T, n) the jump of the velocity at each sample, from and to rest at the ends of a whole motion."""
        around = (self._velocity(self.before), self.segment_velocities(), self._velocity(self.after))
        return np.asarray(np.diff(np.vstack(around), axis=0))

    def _spans(self) -> Vector:
        """(T,) duration of the half segments beside each sample, of a whole segment at the ends [s]."""
        step = np.diff(self.time)
        before = step[0] if self.before is None else self.before.span
        after = step[-1] if self.after is None else self.after.span
        around = np.concatenate(([before], step, [after]))
        return np.asarray(0.5 * (around[:-1] + around[1:]))


def chord_sagitta(limits: JointLimits) -> Vector:
    """(n,) the most that a motion can be off the straight line between two of its samples [rad or m].

    a T^2 / 8 for an acceleration a held over the period T; on a straight leg it is 0.

    Parameters
    ----------
    limits: only their accelerations matter.
    """
    return np.asarray(limits.acceleration * SAMPLE_PERIOD**2 / 8.0)
