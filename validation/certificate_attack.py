"""The certificate against the least distances of random machines on random motions.

A comparison is a machine, a site and a motion. It refutes the certificate if a body comes nearer
than was proven, or if two touch although the certificate calls the motion safe. Links that the
planner does not compare may touch only by construction (validation/link_pairs.py): at nearly all
positions of their joint, or in nearly all configurations; or, if they share a joint, near its axis.
Such contacts are counted.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import backhoe_planner as bp
from backhoe_planner.machine import self_pairs, self_pieces
from validation.campaigns import call_for_all
from validation.dense_sweep import Least, Sweep
from validation.link_pairs import BY_CONSTRUCTION, PIN_PLAY, LinkPair, touch_share
from validation.random_attacks import TURNS, Attack, Attacked, random_attack, random_attacked

_ROUNDING = 1e-6  # m by which a measured distance may be below the proven one
_KEPT = 1.2e-4  # m by which a motion may be below its clearance and still keep it, with rounding
_UNREPORTED = 10.0  # m beyond its clearance, further than which the certificate names no obstacle


@dataclass(frozen=True)
class Refutation:
    """A contradiction to a certificate, and its kind."""

    seed: int
    cause: str
    what: str


@dataclass(frozen=True)
class Comparison:
    """The outcome for one seed.

    Attributes
    ----------
    below: by which part of the dense distance each proven bound is below it.
    safe: whether the certificate calls the motion safe.
    by_construction: pairs of links that were not compared and touched in a motion called safe, as in nearly
        all configurations.
    left_out: pairs of links, several joints apart, that touch in every configuration and were not compared.
    seconds: processor time [s].
    error: the exception raised, if any.
    """

    seed: int
    refutations: tuple[Refutation, ...] = ()
    below: tuple[float, ...] = ()
    safe: bool = False
    by_construction: int = 0
    left_out: int = 0
    seconds: float = 0.0
    error: str = ""


def attack_seeds(
    seeds: Sequence[int],
    *,
    jobs: int = 1,
    folder: Path | None = None,
    watch: Callable[[int, list[Comparison]], object] = lambda done, result: None,
) -> tuple[list[Comparison], bool]:
    """The comparisons of all seeds in their order, and whether the run was interrupted; neighbours share a machine.

    Parameters
    ----------
    watch: called with the comparisons of a block of neighbours; see `Campaign` for it and the others.
    """
    blocks: dict[int, list[int]] = {}
    for seed in seeds:
        blocks.setdefault(seed // TURNS, []).append(seed)
    found, interrupted = call_for_all(
        attack_block, list(blocks.values()), result=list[Comparison], jobs=jobs, folder=folder, watch=watch
    )
    return [comparison for compared in found for comparison in compared], interrupted


def attack_block(seeds: Sequence[int]) -> list[Comparison]:
    """The comparisons of some seeds with the machine of the first."""
    found: list[Comparison] = []
    with tempfile.TemporaryDirectory() as name:
        machine: Attacked | None = None
        for seed in seeds:
            begun = time.process_time()
            try:
                machine = machine or random_attacked(seed, Path(name))
                attack = random_attack(seed, machine, Path(name))
                certificate = bp.certify(machine.robot, attack.scene, attack.trajectory)
                compared = compare(attack, certificate)
            except Exception as error:  # noqa: BLE001  whatever is raised is a finding
                compared = Comparison(seed, error=f"{type(error).__name__}: {error}")
            found.append(replace(compared, seconds=time.process_time() - begun))
    return found


def compare(attack: Attack, certificate: bp.Certificate) -> Comparison:
    """Compare a certificate with the least distances found by dense samples."""
    machine, motion = attack.machine, attack.trajectory
    sweep = machine.sweep(motion.time, motion.q)
    own, excused = _against_itself(attack, certificate, sweep)
    claims = _against_obstacles(attack, certificate, sweep) + own
    refuted = [refutation for claim in claims for refutation in claim.refutations(attack.seed, safe=certificate.safe)]
    below = [claim.below for claim in claims if claim.comparable]
    return Comparison(
        attack.seed,
        tuple(refuted),
        tuple(below),
        certificate.safe,
        by_construction=excused,
        left_out=len(machine.pairs.touching_afar),
    )


@dataclass(frozen=True)
class _Claim:
    """A proven bound of a distance, and the least distance found [m]."""

    proven: float
    found: Least
    clearance: float
    cause: str
    known: bool

    def refutations(self, seed: int, *, safe: bool) -> list[Refutation]:
        """The contradictions to the claim."""
        found = self.found
        touches = found.distance <= 0.0
        least = max(found.distance, 0.0)  # the depth of overlapping parts is not known
        unsafe = (touches and self.proven >= 0.0) or least < self.clearance - _KEPT
        if least >= self.proven - _ROUNDING and not (safe and unsafe):
            return []
        how = f"{found.link} touches" if touches else f"{found.link} is {found.distance:.6f} m from"
        words = [f"{how} {found.other} at {found.time:.4f} s"]
        if least < self.proven - _ROUNDING:
            words.append(f"proven were {self.proven:.6f} m")
        if safe and unsafe:
            words.append("the motion is called safe")
        return [Refutation(seed, self.cause, ", ".join(words))]

    @property
    def comparable(self) -> bool:
        """Whether the two show how sharp the proof is: only if a clearance is kept, else the proof ends early."""
        return self.known and self.clearance + 1e-4 < self.found.distance and self.proven <= self.found.distance

    @property
    def below(self) -> float:
        """By which part of the found distance the proven one is below it."""
        return 1.0 - self.proven / self.found.distance


def _against_obstacles(attack: Attack, certificate: bp.Certificate, sweep: Sweep) -> list[_Claim]:
    proven = {entry.name: entry.distance for entry in certificate.clearances if entry.kind == "obstacle"}
    claims = []
    for obstacle in attack.obstacles:
        found = sweep.to_obstacle(obstacle)
        if found is None:
            continue
        known = obstacle.name in proven
        claim = proven.get(obstacle.name, obstacle.clearance + _UNREPORTED)
        cause = f"nearer to a {obstacle.shape} than proven"
        claims.append(_Claim(claim, found, obstacle.clearance, cause, known))
    return claims


def _against_itself(attack: Attack, certificate: bp.Certificate, sweep: Sweep) -> tuple[list[_Claim], int]:
    """One claim for every cause for which links may come nearer to each other than proven.

    Also the number of pairs that touch by construction although the motion is called safe.
    """
    machine = attack.machine

    def excused(found: Least | None) -> bool:
        """Whether links that are not compared touch by construction."""
        if found is None or found.distance > 0.0 or not certificate.safe:
            return False
        share = touch_share(machine.raw, machine.bodies, "tip", (found.link, found.other))
        return share >= BY_CONSTRUCTION

    robot = machine.robot
    kept, pieces = self_pairs(robot), self_pieces(robot)
    looked_at = {frozenset((pieces[a].link, pieces[b].link)) for a, b in kept.kept}
    looked_at -= {frozenset((pair.link, pair.other)) for pair in kept.left_out}  # some of their parts are left out
    entry = next((entry for entry in certificate.clearances if entry.kind == "machine"), None)
    groups: dict[str, list[LinkPair]] = {}
    claims: list[_Claim] = []
    touching = 0
    for pair, furthest in machine.pairs.counted.items():
        if frozenset(pair) not in looked_at and furthest < PIN_PLAY:
            continue  # by construction
        joint = machine.raw.joint_above.get(pair[0])
        if frozenset(pair) not in looked_at and joint is not None and joint.parent == pair[1] and joint.kind != "fixed":
            folded = sweep.inside_beyond(*pair, joint)
            if excused(folded):
                touching += 1
            elif folded is not None:
                claims.append(_Claim(0.0, folded, 0.0, "the two links of a joint, far from it", False))
            continue
        groups.setdefault(_cause(machine, pair, looked_at), []).append(pair)
    for cause, pairs in groups.items():
        found = sweep.between(pairs)
        known = cause == COMPARED
        while not known and found is not None and excused(found):
            touching += 1
            pairs.remove((found.link, found.other))
            found = sweep.between(pairs)
        if found is None:
            continue
        # the reported least distance excludes pairs that cannot meet or touch by construction
        proven = (_UNREPORTED if entry is None else entry.distance) if known else 0.0
        same = entry is not None and {entry.link, entry.obstacle} == {found.link, found.other}
        claims.append(_Claim(proven, found, 0.0, cause, known and same))
    return claims, touching


COMPARED = "links nearer to each other than proven"


def _cause(machine: Attacked, pair: LinkPair, looked_at: set[frozenset[str]]) -> str:
    """The kind of a refutation by a pair of links that come nearer than proven."""
    if frozenset(pair) in looked_at:
        return COMPARED
    if pair not in machine.pairs.adjacent:
        return "left out: links with several joints between them"
    fixed = [
        name for name in pair if machine.raw.joint_above.get(name) and machine.raw.joint_above[name].kind == "fixed"
    ]
    if fixed:
        return "left out: fixed extras on bodies joined by a joint"
    return "left out: bodies that a joint joins"


@dataclass(frozen=True)
class Summary:
    """The figures of many comparisons."""

    comparisons: int
    claims: int
    safe: int
    errors: int
    refuted: int
    causes: dict[str, int]
    below: tuple[float, float]
    by_construction: int
    left_out: int
    seconds: float


def summarise(comparisons: Sequence[Comparison]) -> Summary:
    """Count the results; `below` has the median and the 90th percentile."""
    below = [share for one in comparisons for share in one.below]
    median, high = (float(np.quantile(below, part)) if below else float("nan") for part in (0.5, 0.9))
    causes = Counter(refutation.cause for one in comparisons for refutation in one.refutations)
    return Summary(
        comparisons=len(comparisons),
        claims=len(below),
        safe=sum(one.safe for one in comparisons),
        errors=sum(bool(one.error) for one in comparisons),
        refuted=sum(bool(one.refutations) for one in comparisons),
        causes=dict(causes.most_common()),
        below=(median, high),
        by_construction=sum(one.by_construction for one in comparisons),
        left_out=sum(one.left_out for one in comparisons),
        seconds=sum(one.seconds for one in comparisons),
    )
