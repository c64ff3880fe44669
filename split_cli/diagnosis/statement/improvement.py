"""Results on held-out time: one-step and open-loop errors with the findings, and the corrected vehicle."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from split_cli.vehicle.parameters import EffectSpec

NORMAL_95 = 1.96  # standard errors on either side that hold 95 % of a normal distribution
_SHOWS = 1.25  # error before over the noise floor from which on held-out rollouts show a gap [1]


@dataclass(frozen=True)
class StateChange:
    """Held-out rms open-loop errors of one velocity: nominal model and corrected vehicle."""

    channel: str
    unit: str
    horizon: float  # [s]
    # nominal, corrected, persistence, noise_floor: in `unit`.
    nominal: float
    corrected: float
    persistence: float
    noise_floor: float
    change: float  # of the squared error, corrected less nominal, in standard errors over blocks of time [1]

    @property
    def is_worse(self) -> bool:
        """Whether the corrected vehicle predicts worse than the nominal one, beyond chance and beyond noise."""
        return self.change > NORMAL_95 and self.corrected > self.noise_floor

    @property
    def is_better(self) -> bool:
        """Whether it predicts better, beyond chance."""
        return self.change < -NORMAL_95


@dataclass(frozen=True)
class CorrectedVehicle:
    """The vehicle file with the findings of the car, compared with the given one on held-out time."""

    # Every velocity after one step of 0.05 s and at the longest horizon that fits, 2 s at most, without those of which
    # a drive says nothing (`logs.drive_metadata.CIRCULAR`).
    states: tuple[StateChange, ...]
    # Values by term in the file: those of the findings refitted without other parts, see `heldout.fitted_alone`.
    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # Effects in the file that are no findings, and the judgement `alone` of the file without them. With them, values
    # are those of the joint fit.
    further: tuple[EffectSpec, ...] = ()
    alone: "CorrectedVehicle | None" = None

    @property
    def farthest(self) -> tuple[StateChange, ...]:
        """Return the velocities at the longest horizon."""
        longest = max((one.horizon for one in self.states), default=0.0)
        return tuple(one for one in self.states if one.horizon == longest)

    @property
    def runs_away(self) -> bool:
        """Whether persistence is better than the corrected vehicle at the longest horizon, but not than the nominal.

        Notes
        -----
        Squared errors are summed over velocities, each over that of persistence. A single large error, as by a spin of
        the model, also increases the standard error, so that the test of `is_worse` would not detect it.
        """
        held = [one for one in self.farthest if one.persistence > 0.0]
        corrected, nominal = (
            sum((getattr(one, name) / one.persistence) ** 2 for one in held) for name in ("corrected", "nominal")
        )
        return corrected > len(held) >= nominal

    @property
    def is_refuted(self) -> bool:
        """Whether it is worse than the nominal model at the longest horizon in some velocity and better in none.

        Both beyond chance.
        """
        return any(one.is_worse for one in self.farthest) and not any(one.is_better for one in self.farthest)

    @property
    def accepted(self) -> bool:
        """Whether it is no worse than the nominal model in any state beyond chance, and does not run away."""
        return not self.runs_away and not any(one.is_worse for one in self.states)


@dataclass(frozen=True)
class HorizonErrors:
    """Held-out rms errors of open-loop rollouts of one length: v_x, v_y [m/s], r [rad/s]."""

    horizon: float  # [s]
    # before, physics, split_only, after, persistence: three: as in `Improvement`.
    before: tuple[float, ...]
    physics: tuple[float, ...]
    split_only: tuple[float, ...]
    after: tuple[float, ...]
    persistence: tuple[float, ...]
    noise_floor: tuple[float, ...]  # three: what sensor noise at the start and at the end makes
    # 95 % intervals by block bootstrap, channel by channel, and the number of ``blocks``.
    confidence: Mapping[str, object]
    starts: int
    # Change of a stage's squared error against ``before``, in standard errors over blocks of time [1].
    change: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    # Change of the squared error of ``after`` against ``physics``, in the same unit.
    beside_physics: tuple[float, ...] = ()
    # Mean error of a stage over all starts, model less recording.
    mean: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def mean_share(self, stage: str, k: int) -> float | None:
        """Return the squared mean error over the mean squared error of a stage in channel k [1]; None if unknown."""
        error = getattr(self, stage)[k]
        return (self.mean[stage][k] / error) ** 2 if stage in self.mean and error > 0.0 else None

    def most_changed(self, stage: str) -> int:
        """Return the channel (0 to 2) whose error a stage changes most in units of noise, for better or worse."""
        changes = zip(self.before, getattr(self, stage), self.noise_floor, strict=True)
        sizes = [abs(other - before) / max(noise, 1e-12) for before, other, noise in changes]
        return sizes.index(max(sizes))

    def worse(self, stage: str) -> tuple[int, ...]:
        """Return the channels whose error a stage makes larger beyond chance (5 %, two-sided)."""
        return tuple(k for k, z in enumerate(self.change.get(stage, ())) if z > NORMAL_95)

    def worse_with_split(self) -> tuple[int, ...]:
        """Return the channels in which SPLIT beside the terms is worse than the terms alone.

        It is worse beyond chance, or worse than persistence where the terms alone are not: one diverging rollout
        increases the standard error too, so that the first test would not detect it.
        """
        apart = set(self.beaten_by_persistence("after")) - set(self.beaten_by_persistence("physics"))
        beyond = {k for k, z in enumerate(self.beside_physics) if z > NORMAL_95}
        return tuple(sorted(k for k in apart | beyond if self.after[k] > self.physics[k]))

    def beaten_by_persistence(self, stage: str) -> tuple[int, ...]:
        """Return the channels in which persistence predicts better than a stage."""
        pairs = zip(getattr(self, stage), self.persistence, strict=True)
        return tuple(k for k, (error, held) in enumerate(pairs) if error > held)


@dataclass(frozen=True)
class Improvement:
    """Held-out one-step errors over the step's length, of v_x, v_y [m/s^2] and r [rad/s^2], see `LabelErrors`."""

    # before, physics, after, split_only, persistence: three each: the nominal model with the shared discrepancy; with
    # terms; with terms and SPLIT; with SPLIT alone; last velocities held.
    before: tuple[float, ...]
    physics: tuple[float, ...]
    after: tuple[float, ...]
    split_only: tuple[float, ...]
    persistence: tuple[float, ...]
    noise_floor: tuple[float, ...] | None  # three
    confidence: Mapping[str, object]  # 95 % intervals by block bootstrap, channel by channel
    rollouts: tuple[HorizonErrors, ...] = ()  # shortest first; none where no horizon fits into the held-out time
    # For ``physics``, ``split_only`` and ``after``: the removed share of the squared error above the noise floor,
    # channels weighted by their noise, and its 95 % interval; None if there was nothing to improve.
    removed: Mapping[str, tuple[float, float, float] | None] = field(default_factory=dict)
    # How ``before`` and ``physics`` use the shared discrepancy, ``longitudinal`` and ``lateral``: ``nominal`` (not at
    # all), ``taught`` (at recorded states) or ``taught_elsewhere`` (also at other states).
    simulation_part: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    # Trust: the share of SPLIT's prediction that ``split_only`` and ``after`` apply to each output [1].
    trust: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def corrects_simulation(self) -> bool:
        """Whether the terms improve what the simulation itself predicts: some error beyond chance, and none gets worse.

        False if the shared discrepancy is left out, as without a simulation.
        """
        removed, last = self.removed.get("physics"), self.rollouts[-1] if self.rollouts else None
        uses_simulation = any(way != "nominal" for way in self.simulation_part.get("physics", {}).values())
        return uses_simulation and last is not None and not last.worse("physics") and bool(removed) and removed[1] > 0.0

    @property
    def shows_gap(self) -> bool:
        """Whether held-out time shows the gap at all; an effect at one place may lie outside it."""
        shown = [b / max(n, 1e-12) for one in self.rollouts for b, n in zip(one.before, one.noise_floor, strict=True)]
        return any(self.removed.values()) or max(shown, default=0.0) > _SHOWS
