"""`split evaluate`: score predictors and features beside the nominal model, persistence and the noise floor."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import DriveError, SetError, SplitError
from split_cli.learning.cells import without_points
from split_cli.learning.features import Z1, Z2, FeatureSet, parse_features
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.pieces import features_along
from split_cli.learning.region import Region
from split_cli.learning.training_set import TrainingSet, read_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import Drive, open_drive
from split_cli.logs.drive_metadata import ingest_found
from split_cli.logs.laps import first_lap
from split_cli.prediction import PREDICTORS, Predictor, make_predictor
from split_cli.scoring.application import time_per_query
from split_cli.scoring.evaluation import (
    HeldOutSamples,
    Score,
    ScoreTally,
    baseline_tallies,
    labels_left,
    pooled_noise_floor,
    predictor_tally,
    rollout_trajectories,
    score,
)
from split_cli.scoring.evidence import MOST_ROWS, TrainingDrive
from split_cli.scoring.feature_sets import DEFAULT_SIZES, PAPER_SIZE, informative_sets
from split_cli.scoring.found_lags import Prepared, decide, lag_notes
from split_cli.scoring.intervals import interval_shares, interval_warnings
from split_cli.scoring.report import Evaluation, EvaluationSettings, RolloutScore, SetFacts, SizeScore
from split_cli.scoring.rollouts import RolloutSums, score_rollouts
from split_cli.scoring.run import EvaluationRun, Trace
from split_cli.scoring.running_trust_on_drive import FollowedPredictor
from split_cli.scoring.splits import hold_out_blocks, whole_drive
from split_cli.scoring.vehicle_match import belonging
from split_cli.scoring.verdict import (
    BlockErrors,
    Comparison,
    comparisons_of,
    number_blocks,
    one_step_errors,
    rollout_errors,
    verdict,
    warnings_of,
)
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.engine import HERE, Engine
from split_cli.workflows.evaluation_notes import (
    drive_facts,
    notes_of,
    notes_on_own_sets,
    notes_on_parts,
    notes_on_states,
    overlap_notes,
    same_interval,
    silent_states,
    sources_not_judged,
    with_measured_error,
)
from split_cli.workflows.other_vehicle import CHANGED_FILE_ADVICE, trained_for_another
from split_cli.workflows.recordings import RecordingCorrection, usable_drives, vehicle_warnings

#: Marks a predictor whose whole correction is applied, beside one that is trusted in part.
PLAIN = ", full trust"
#: Marks a predictor that is trusted, at each moment, as far as the drive until then supports.
RUNNING = ", running trust"
#: A drive with the start rows of its rollouts and the trajectories of every model.
Rolled = tuple[HeldOutSamples, np.ndarray, dict[tuple[str, str], np.ndarray]]


def evaluate_files(
    drives: Sequence[str | Path],
    vehicle: str | Path | None,
    settings: EvaluationSettings,
    set_path: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
    engine: Engine = HERE,
    *,
    keep_going: bool = False,
) -> EvaluationRun:
    """Read drives, vehicle and set, and evaluate; see `evaluate`.

    With `keep_going` drives that cannot be read or are of another vehicle are left out, instead of stopping.

    Raises
    ------
    SplitError
        If neither vehicle nor set is given, they are not of the same physics, or a set stands where drives do.
    """
    swapped = next((Path(path) for path in drives if Path(path).suffix == ".split"), None)
    if swapped is not None:
        advice = f"Name drives first, then the set: split evaluate DRIVE --set {swapped.name}"
        raise SplitError("is a trained set, not a drive", where=swapped.name, advice=advice)
    trained = read_set(set_path) if set_path else None
    if vehicle is None and trained is None:
        raise SplitError("needs a vehicle or a trained set", advice="Give --vehicle or --set.")
    car = read_vehicle(vehicle) if vehicle else trained.nominal_vehicle
    if trained is not None and trained.nominal_vehicle.digest() != car.digest():
        what = trained_for_another(trained.nominal_vehicle, car)
        raise SetError(what, where=str(set_path), advice=CHANGED_FILE_ADVICE)
    failures: tuple[str, ...] = ()
    known: dict[Path, Drive] = {}
    paths = [Path(path) for path in drives]
    if keep_going:
        paths, failures = usable_drives(paths, car, settings.held, settings.any_vehicle, known)
    opened = [known[p] if p in known else open_drive(p, settings.held, beside=len(paths)) for p in paths]
    return replace(evaluate(opened, car, settings, trained, progress, engine), failures=failures)


def evaluate(
    drives: Sequence[Drive],
    vehicle: Vehicle,
    settings: EvaluationSettings,
    trained: TrainingSet | None = None,
    progress: Callable[[str], None] = lambda text: None,
    engine: Engine = HERE,
) -> EvaluationRun:
    """Score predictors on drives.

    Parameters
    ----------
    vehicle : Vehicle
        The nominal model; what a set found beyond it (`TrainingSet.found`) corrects like the residual does.
    trained : TrainingSet, optional
        Scored on the whole of every drive. Without one, sets are trained on the training blocks, with
        hyperparameters fitted there, and scored on the held-out blocks.
    progress : callable
        Gets a line about what is being done.
    engine : Engine
        Where each drive is labelled, predicted and rolled out; the numbers do not depend on it.

    Raises
    ------
    SplitError
        If a setting is unknown, a drive too short, or nothing can be scored.
    """
    settings.check(with_set=trained is not None)
    if trained is not None:
        names = trained.features.names
        short = {Z1.names: "z1", Z2.names: "z2"}.get(names, ",".join(names))
        settings = replace(settings, features=(short,), horizon=trained.horizon)
    correct = RecordingCorrection(vehicle)
    drives = [correct(drive) for drive in drives]
    fits = [belonging(drive, vehicle) for drive in drives]
    warnings = vehicle_warnings(drives, vehicle, settings.any_vehicle, fits)
    model = SingleTrack(vehicle)
    labelled_sets, nominal = _labelled_sets(drives, vehicle, settings, trained, progress, engine)
    baselines = [baseline_tallies(h, model, _variance_of(nominal, labelled_sets[0][2])) for h in nominal]
    scores, traces, tallies, predictors = _score_predictors(labelled_sets, baselines, settings, progress, engine)
    progress("rollouts")
    rollouts, rollout_scores, rolled = _rollouts(nominal, model, predictors, settings, engine)
    comparisons, verdicts = _comparisons(model, nominal, traces, rolled, settings)
    sizes = _sizes(labelled_sets, baselines, settings, progress)
    shown = [trace for trace in traces if trace.name in settings.predictors]
    followed = [trace for trace in traces if trace.name.endswith(RUNNING)]
    intervals = interval_shares([*shown, *followed], {name: own for name, _, own in labelled_sets}, RUNNING)
    progress("noise floor")
    facts = tuple(drive_facts(h, model, trained, one) for h, one in zip(nominal, fits, strict=True))
    report = Evaluation(
        settings=settings,
        vehicle=vehicle.name,
        drives=facts,
        sets=tuple(
            SetFacts(name, own.size, own.cell_count, own.kernel, own.trust, own.found) for name, _, own in labelled_sets
        ),
        scores=tuple(scores),
        noise_floor=pooled_noise_floor(model, nominal),
        rollouts=tuple(rollout_scores),
        sizes=tuple(sizes),
        comparisons=comparisons,
        verdicts=verdicts,
        intervals=intervals,
        notes=(
            *warnings,
            *notes_of(facts, labelled_sets[0][1], settings, rollout_scores),
            *_overlap_notes(labelled_sets[0], settings, trained is None),
            *_notes_of_sets(labelled_sets, settings, trained is None),
            *notes_on_states(drives, trained),
            *correct.notes,
            *(
                text
                for s in sources_not_judged(trained, drives)
                for text in ingest_found(s.name, (*s.faults, *s.remarks))
            ),
            *(note for *_, own in labelled_sets for note in lag_notes(own)),
            *warnings_of(with_measured_error([c for c in comparisons if c.name in settings.predictors], drives)),
            *(interval_warnings(shown, intervals, silent_states(drives, trained)) if trained else ()),
        ),
    )
    sets = tuple(own for *_, own in labelled_sets)
    drawn_from = tuple(tuple(held) for _, held, _ in labelled_sets)
    return EvaluationRun(report, sets, drawn_from, tuple(traces), tallies, rollouts)


def _labelled_sets(
    drives: Sequence[Drive],
    vehicle: Vehicle,
    settings: EvaluationSettings,
    trained: TrainingSet | None,
    progress: Callable[[str], None],
    engine: Engine,
) -> tuple[list[tuple[str, list[HeldOutSamples], TrainingSet]], list[HeldOutSamples]]:
    """Return each feature set with samples and trained set, and the samples of the nominal model."""
    labelled_sets, nominal = [], []
    for features in settings.features:
        progress(f"{features}: labels and training")
        parsed = parse_features(features)
        held = _hold_out(drives, _with_states_of_features(vehicle, trained), parsed, settings, trained, engine)
        nominal = nominal or held
        own = trained or _train(held, vehicle, settings)
        if own.found_effects:
            held = _hold_out(drives, own.vehicle, parsed, settings, trained, engine)
        labelled_sets.append((features, held, own))
    if not any(len(h.tested) for h in nominal):
        what = "no test sample can be scored: all are in gaps, too slow or not finite"
        advice = "`split label` counts why; look at units and signs with `split info`."
        raise DriveError(what, where=", ".join(h.drive.name for h in nominal), advice=advice)
    return labelled_sets, nominal


def _overlap_notes(
    labelled_set: tuple[str, list[HeldOutSamples], TrainingSet], settings: EvaluationSettings, is_own: bool
) -> Iterator[str]:
    """Yield which drives share rows with one that the set was trained on."""
    _, held, trained = labelled_set
    if settings.protocol != "paper":
        for number, h in enumerate(held):
            yield from overlap_notes("the set", trained, h.drive, h.z, number if is_own else None)


def _notes_of_sets(labelled_sets: Sequence[tuple], settings: EvaluationSettings, are_own: bool) -> Iterator[str]:
    """Yield that the sets are the evaluation's own, where they are, and of which part of long drives it is."""
    finds_trust = are_own and _finds_trust(settings)
    if finds_trust:
        yield from notes_on_own_sets([(name, own) for name, _, own in labelled_sets])
    yield from notes_on_parts(labelled_sets[0][1], finds_trust)


def _train(held: Sequence[HeldOutSamples], vehicle: Vehicle, settings: EvaluationSettings) -> TrainingSet:
    """Return a set trained on the training blocks, trusted as far as those blocks show."""

    def prepared(car: Vehicle, labelled: Sequence[HeldOutSamples]) -> Prepared[TrainingSet]:
        labels = [_training(h) for h in labelled]
        trained = train_in_memory(labels, car)
        parts = [TrainingDrive(h.drive, own).middle(MOST_ROWS) for h, own in zip(labelled, labels, strict=True)]
        return Prepared(without_points(trained), parts, trained)

    def relabelled(late: Vehicle) -> Prepared[TrainingSet]:
        again = [
            compute_labels(h.drive, late, h.labels.features, h.labels.region, horizon=settings.horizon) for h in held
        ]
        return prepared(late, [replace(h, labels=made) for h, made in zip(held, again, strict=True)])

    by_file = prepared(vehicle, held)
    if not _finds_trust(settings):
        return by_file.made
    chosen = decide(by_file, relabelled)
    return replace(chosen.made, trust=chosen.empty.trust, found_effects=chosen.empty.found_effects)


def _finds_trust(settings: EvaluationSettings) -> bool:
    """Return whether a set that is trained here is trusted as far as held-out blocks show."""
    return settings.trust != "full" and settings.protocol != "paper"


def _variance_of(nominal: Sequence[HeldOutSamples], trained: TrainingSet) -> np.ndarray | None:
    """Return the mean square of training labels of the nominal model, shape (3,), or of the set's points."""
    if not trained.size:
        return None
    if not trained.found_effects:
        return np.mean(np.square(trained.y), axis=0)
    labels = [_training(h) for h in nominal]
    return np.mean(np.square(np.concatenate([part.y[part.accepted] for part in labels])), axis=0)


def _with_states_of_features(vehicle: Vehicle, trained: TrainingSet | None) -> Vehicle:
    """Return the vehicle with those terms that a set found beyond its file whose states are its features."""
    found = () if trained is None else trained.found
    named = {name.partition(".")[0] for name in (() if trained is None else trained.features.names)}
    return vehicle.with_effects(*(effect for effect in found if effect.term in named))


def _hold_out(
    drives: Sequence[Drive],
    vehicle: Vehicle,
    features: FeatureSet,
    settings: EvaluationSettings,
    trained: TrainingSet | None,
    engine: Engine,
) -> list[HeldOutSamples]:
    region = trained.region if trained else Region.of(vehicle)
    plain = trained.plain if trained else False
    if settings.protocol == "paper":
        drives = [drive.select(first_lap(drive, vehicle.wheelbase)) for drive in drives]
    whole = trained is not None or settings.protocol == "paper"
    splits = [
        whole_drive(drive) if whole else hold_out_blocks(drive, settings.blocks, settings.holdout, settings.guard)
        for drive in drives
    ]
    jobs = [(drive, vehicle, features, region, settings.horizon, plain) for drive in drives]
    made = engine.map(_labels_and_features, jobs)
    return [HeldOutSamples(*known, *found) for *known, found in zip(drives, splits, made, strict=True)]


def _labels_and_features(job: tuple[Drive, Vehicle, FeatureSet, Region, float, bool]) -> tuple[Labels, np.ndarray]:
    drive, vehicle, features, region, horizon, plain = job
    labels = compute_labels(drive, vehicle, features, region, horizon=horizon, plain=plain)
    return labels, features_along(SingleTrack(vehicle), drive, features)


def _training(held: HeldOutSamples) -> Labels:
    """Return the labels that train: of the training blocks, or all where the drive is scored in sample."""
    return held.labels.within(held.split.train if held.split.train.any() else held.split.test)


def _score_predictors(
    labelled_sets: list[tuple[str, list[HeldOutSamples], TrainingSet]],
    baselines: list[dict[str, ScoreTally]],
    settings: EvaluationSettings,
    progress: Callable[[str], None],
    engine: Engine,
) -> tuple[list[Score], list[Trace], dict, dict]:
    pooled = {name: _sum([b[name] for b in baselines]) for name in baselines[0]}
    scores = [score(name, tally, pooled) for name, tally in pooled.items()]
    tallies = {(name, ""): tally for name, tally in pooled.items()}
    by_drive = [
        score(name, tally, own, drive=held.drive.name)
        for held, own in zip(labelled_sets[0][1], baselines, strict=True)
        for name, tally in own.items()
    ]
    traces, predictors = [], {}
    for features, held, training_set in labelled_sets:
        longest = max(held, key=lambda h: len(h.tested))
        rows = longest.labels.row[longest.tested]
        # How far an answer is believed changes neither the time of one query [s] nor what it is compared with.
        spent: dict[str, float] = {}
        compared: dict[str, list[Labels]] = {}
        for name, way in _named(settings, training_set):
            believed = replace(training_set, trust=Trust.full()) if way == PLAIN else training_set
            progress(f"{features}: {name}{way} on {training_set.size} points")
            predictor = make_predictor(name, believed)
            if name not in compared:
                compared[name] = list(engine.map(_called, [(labels_left, h, predictor) for h in held]))
            asked = [predictor] * len(held)
            pairs = list(zip(held, compared[name], strict=True))
            if way == RUNNING:
                asked = list(engine.map(_called, [(FollowedPredictor, predictor, *pair) for pair in pairs]))
            jobs = [(predictor_tally, h, one, tested) for (h, tested), one in zip(pairs, asked, strict=True)]
            parts = list(engine.map(_called, jobs))
            label = f"{name}{way}"
            known = {"features": features, "points": training_set.size}
            known["uses_recorded_future"] = predictor.needs_context
            tally = tallies[label, features] = _sum([part for part, _ in parts])
            if name not in spent:
                spent[name] = time_per_query(predictor, longest.drive, longest.z, rows)
            scores.append(score(label, tally, pooled, time_per_query=spent[name], **known))
            predictors[label, features] = (held, asked)
            for (h, tested), own, (part, prediction) in zip(pairs, baselines, parts, strict=True):
                by_drive.append(score(label, part, own, drive=h.drive.name, **known))
                noise = training_set.kernel.noise_variance
                traces.append(Trace(label, features, h, tested, prediction, noise))
    traces.sort(key=lambda trace: trace.name.endswith((PLAIN, RUNNING)))  # figures show what is believed
    return scores + (by_drive if len(baselines) > 1 else []), traces, tallies, predictors


def _called(job: tuple) -> Any:
    """Call the first of a job with the others."""
    function, *arguments = job
    return function(*arguments)


def _named(settings: EvaluationSettings, training_set: TrainingSet) -> list[tuple[str, str]]:
    """Return the predictors and how each is believed: the plain way first, where trust makes a difference."""
    if settings.protocol != "held-out":
        return []
    ways = ("",) if training_set.trust.is_full else (PLAIN, "")
    # Where nothing is trusted there is nothing to follow.
    running = (RUNNING,) if training_set.trust.array.any() else ()
    return [
        (name, way)
        for name in settings.predictors
        for way in (*ways, *(() if PREDICTORS[name][1] == "FitcPredictor" else running))
    ]


def _sum(parts: Sequence) -> object:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def _rollouts(
    drives: list[HeldOutSamples],
    model: SingleTrack,
    predictors: dict[tuple[str, str], tuple[list[HeldOutSamples], list[Predictor]]],
    settings: EvaluationSettings,
    engine: Engine,
) -> tuple[dict[tuple[str, str], RolloutSums], list[RolloutScore], list[Rolled]]:
    longest = max(len(held.drive) * held.drive.period for held in drives)
    if not settings.rollout or settings.protocol == "paper" or max(settings.rollout) > longest:
        return {}, [], []
    steps = max(1, round(max(settings.rollout) / drives[0].labels.horizon))
    pooled: dict[tuple[str, str], RolloutSums] = {}
    rolled: list[Rolled] = []
    jobs = [
        (held, model, {key: (parts[at], asked[at]) for key, (parts, asked) in predictors.items()}, steps)
        for at, held in enumerate(drives)
        if same_interval(held, drives[0])
    ]
    for (held, *_), (starts, trajectories, scored) in zip(jobs, engine.map(_rolled_out, jobs), strict=True):
        rolled.append((held, starts, trajectories))
        for key, sums in scored.items():
            pooled[key] = pooled[key] + sums if key in pooled else sums
    scores = []
    for seconds in settings.rollout:
        step = min(steps, max(1, round(seconds / drives[0].labels.horizon))) - 1
        for (name, features), sums in pooled.items():
            if sums.count:
                at = (sums.count, sums.diverged, sums.rmse[step], float(sums.distance[step]))
                scores.append(RolloutScore(name, features, seconds, *at))
    return pooled, scores, rolled


def _rolled_out(
    job: tuple[HeldOutSamples, SingleTrack, dict[tuple[str, str], tuple[HeldOutSamples, Predictor]], int],
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray], dict[tuple[str, str], RolloutSums]]:
    held = job[0]
    starts, trajectories = rollout_trajectories(*job)
    return starts, trajectories, score_rollouts(held.drive, starts, held.labels.window, trajectories)


def _comparisons(
    model: SingleTrack,
    nominal: Sequence[HeldOutSamples],
    traces: Sequence[Trace],
    rolled: Sequence[Rolled],
    settings: EvaluationSettings,
) -> tuple[tuple[Comparison, ...], tuple[str, ...]]:
    """Return every predictor beside the nominal model and persistence, and a verdict on each in words."""
    blocks: dict[int, np.ndarray] = {}

    def block_of(drive: Drive) -> np.ndarray:
        if id(drive) not in blocks:
            first = 1 + max((int(b.max()) for b in blocks.values()), default=-1)
            blocks[id(drive)] = number_blocks(drive["t"], drive.segment, first)
        return blocks[id(drive)]

    by_file = {id(held.drive): held for held in nominal}
    found: dict[tuple[str, str], tuple[Comparison, ...]] = {}
    for key in dict.fromkeys((trace.name, trace.features) for trace in traces):
        parts: list[BlockErrors] = [
            one_step_errors(by_file[id(t.held.drive)], model, t.tested, t.prediction.mean, block_of(t.held.drive))
            for t in traces
            if (t.name, t.features) == key
        ]
        parts += [
            rollout_errors(held, starts, trajectories, key, seconds, block_of(held.drive))
            for held, starts, trajectories in rolled
            for seconds in settings.rollout
            if len(starts)
        ]
        found[key] = comparisons_of(*key, parts)
    believed = {key: with_measured_error(own, [held.drive for held in nominal]) for key, own in found.items()}
    verdicts = tuple(
        f"{name} {features} {verdict(own, believed.get((name + RUNNING, features), ()))}"
        for (name, features), own in believed.items()
    )
    return tuple(comparison for own in found.values() for comparison in own), verdicts


def _sizes(
    labelled_sets: list[tuple[str, list[HeldOutSamples], TrainingSet]],
    baselines: list[dict[str, ScoreTally]],
    settings: EvaluationSettings,
    progress: Callable[[str], None],
) -> list[SizeScore]:
    paper = settings.protocol == "paper"
    asked = settings.sizes or ((PAPER_SIZE,) if paper else DEFAULT_SIZES if len(labelled_sets) > 1 else ())
    pooled = {name: _sum([b[name] for b in baselines]) for name in baselines[0]}
    scores = []
    for features, held, training_set in labelled_sets if asked else ():
        candidates = Labels.joined([_training(h) for h in held])
        for size, chosen in informative_sets(training_set.vehicle, candidates, training_set.kernel, asked):
            progress(f"{features}: full on the {chosen.size} most informative samples")
            predictor = make_predictor("full", chosen)
            tally = _sum([predictor_tally(h, predictor, labels_left(h, predictor))[0] for h in held])
            known = {"features": features, "points": chosen.size}
            scores.append(SizeScore(size, score("full", tally, pooled, **known)))
    return scores
