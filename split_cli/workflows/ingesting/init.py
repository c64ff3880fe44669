"""The first two files of a newcomer: a drafted map and a vehicle file to fill in."""

import contextlib
import shlex
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from split_cli.errors import LogError, SplitError
from split_cli.files import atomic_directory
from split_cli.logs.assembling.derivations import DERIVATIONS, WITHOUT_RATE, derivations_for
from split_cli.logs.drafting.draft import SIDESLIP_OF_TIRES, WHAT_GIVES_R, in_ranges, lines_on_presets, lines_on_runs
from split_cli.logs.drafting.nameless import has_no_name
from split_cli.logs.drafting.several_logs import agreed_draft
from split_cli.logs.drafting.suggest import Draft, draft_map, render_draft
from split_cli.logs.readers.opening import holds_titles_alone
from split_cli.logs.readers.unpacking import plain_name
from split_cli.signals import REQUIRED_CHANNELS
from split_cli.workflows.ingesting.ingest import open_logs
from split_cli.workflows.sources import enter_all, find_sources, typed_address

VEHICLE_TEMPLATE = """# The nominal vehicle. Fill in what stands empty; every command names all that is missing.
# A value may also be written {value: 1573, source: published}; source is published, assumed or calibrated.
name: car

# Required. From scales, the maker's data sheet or a workshop.
mass:                 # kg, the whole car as driven
yaw_inertia:          # kg m^2 about the vertical axis; near mass x cg_to_front_axle x cg_to_rear_axle if unknown
cg_to_front_axle:     # m
cg_to_rear_axle:      # m; wheelbase less cg_to_front_axle
wheel_radius:         # m, effective: distance rolled over angle turned
max_torque:           # N m, driving, all wheels together
friction_coefficient: 1.0   # 1, tyre on road: about 1.0 dry asphalt, 0.5 wet cobbles, 0.3 snow
cg_height:            # m above ground; informs some terms only
rolling_resistance_front: 0.0   # N, `split calibrate` finds it
rolling_resistance_rear: 0.0    # N
drag_coefficient: 0.0           # N/(m/s)^2, `split calibrate` finds it
drive_split_front:    # 0 rear drive, 1 front drive

# Optional.
# max_brake_torque:   # N m, all wheels together; default max_torque
# brake_split_front:  # default drive_split_front; road cars about 0.7

# F_y = D sin(C atan(B alpha)) for the whole axle. To start: D = friction x static load of the axle,
# C = 1.4, B = cornering stiffness / (C D), about 10 for road tyres. `split calibrate` fits them to a gentle drive.
front_tire: {B: {value: 10.0, source: assumed}, C: {value: 1.4, source: assumed}, D: }   # D in N
rear_tire: {B: {value: 10.0, source: assumed}, C: {value: 1.4, source: assumed}, D: }    # D in N
"""


@dataclass(frozen=True)
class InitResult:
    """What was written and what comes next."""

    map_path: Path
    vehicle_path: Path
    draft: Draft
    log: str  # as the user named it, for the command to run
    result: str  # drive to write, called as the log, or the folder of several
    differences: tuple[str, ...] = ()  # of several logs, where one map does not fit all

    @property
    def next_steps(self) -> tuple[str, ...]:
        """What to do, in order."""
        mapped = {s.channel for s in self.draft.suggestions if s.status != "open"}
        missing = [channel for channel in REQUIRED_CHANNELS if channel not in mapped]
        opened = {s.channel for s in self.draft.suggestions if s.status == "open"}
        kinds = ", ".join(self.draft.undefined[:6])
        where = "begin anew with --msg-path FOLDER, where their .msg files are."
        unread = [f"The log does not define {kinds}. To read them, {where}"] if kinds else []
        if not mapped:
            kept = f" Comments in {self.map_path} say what was found of {', '.join(sorted(opened))}."
            return (
                *unread,
                *lines_on_presets(self.draft.presets),
                f"No channel was recognised. See what the log holds: split ingest {self.log} --list",
                f"Write the channels into {self.map_path}; docs/formats.md, Signal map, shows how."
                + (kept if opened else ""),
            )
        chosen = derivations_for(missing, mapped | _to_record(missing, mapped))
        derived = {channel for name in chosen for channel in DERIVATIONS[name].makes}
        left = [channel for channel in missing if channel not in derived]
        lost = [channel for channel in left if channel not in opened]
        steps = [*self._to_fill_and_check(missing, opened, "a_y" if WITHOUT_RATE in chosen else "r")]
        if found := [channel for channel in left if channel in opened]:
            steps.append(f"Map {', '.join(found)} in {self.map_path}: its comments say what was found.")
        if WITHOUT_RATE in chosen and "vy" in missing:
            steps.insert(0, SIDESLIP_OF_TIRES)
        if lost:
            # What no step of the user's mends stands first, before values are looked up for nothing.
            steps = [self._what_is_missing(lost, bool(unread)), *steps]
        steps = [*(unread if missing else []), *steps, *self.differences]
        if any(" does not hold " in text for text in self.differences):
            anew = shlex.quote(str(self.map_path.parent) + "_together")
            steps.append(f"If the logs are parts of one drive, begin anew: split init {self.log} --together -o {anew}")
        run = f"With {', '.join(lost)}, run" if lost else "Run"
        vehicle, maps = shlex.quote(str(self.vehicle_path)), shlex.quote(str(self.map_path))
        derive = "".join(f" --derive {name}" for name in chosen)
        derive += f" --gap {self.draft.gap:.2g}" if self.draft.gap else ""
        steps.append(f"{run}: split ingest {self.log} --vehicle {vehicle} --map {maps}{derive} -o {self.result}")
        return tuple(steps)

    def _to_fill_and_check(self, missing: Sequence[str], opened: Collection[str], turning: str) -> Iterator[str]:
        """Yield what a user who knows the car and the logger has to write or confirm; `turning` is recorded."""
        still = [c for c in missing if c in opened and all(s.never_changes for s in self.draft.all_of(c))]
        if "vx" in still:
            yield (
                f"Here {', '.join(still)} never change{'s' * (len(still) == 1)}: if the car stands, take a log in "
                "which it drives."
            )
        yield f"Fill in the empty values of {self.vehicle_path}."
        yield from (*lines_on_presets(self.draft.presets), *lines_on_runs(self.draft))
        if self.draft.rows:
            yield f"The log {self.draft.rows.partition(': the log ')[2]}: `rows:` in {self.map_path} chooses one."
        if self.draft.cars:
            yield f"The log {self.draft.cars}. For another car, write its names in {self.map_path}."
        check = [s.channel for s in self.draft.suggestions if s.status == "assumed"]
        if check := ["time", *check] if "# CHECK" in self.draft.time else check:
            yield f"Look at the lines marked CHECK in {self.map_path}: {', '.join(check)}."
        if self.draft.time.startswith("# time: {period"):
            yield f"State the time in {self.map_path}, or add --row-rate HZ below: no column of the log counts it."
        if self.draft.time.startswith("# time: needed: "):
            yield f"Give the log a clock: {self.draft.time.removeprefix('# time: needed: ')}."
        if not self.draft.left:
            by_gravity = f" {self.draft.by_gravity}" if self.draft.by_gravity else ""
            yield (
                f"Check in a left turn that {turning} and delta are positive: nothing recorded tells left from right."
                + by_gravity
            )

    def _what_is_missing(self, lost: Sequence[str], some_unread: bool) -> str:
        """Say which required channels nothing in the log gives, and where they may come from."""
        if some_unread:
            return f"Nothing that can be read gives {', '.join(lost)}."
        nameless = in_ranges([name for name in self.draft.unused if has_no_name(name)])
        unnamed = f" One of {', '.join(nameless[:8])} may be it: they have no names." if nameless else ""
        it, has = ("them", "they have") if len(lost) > 1 else ("it", "it has")
        gyro = f" For r {WHAT_GIVES_R}" if "r" in lost else ""
        return (
            f"Nothing in this log gives {', '.join(lost)}, and no drive can be made without {it}: "
            f"another file may hold {it} (--together), or {has} to be recorded.{gyro} "
            f"Comments in {self.map_path} say what will do.{unnamed}"
        )

    def to_text(self) -> str:
        """Return the result for a terminal."""
        counts = {
            status: [s.channel for s in self.draft.suggestions if s.status == status]
            for status in ("judged", "unsided", "stated", "assumed", "open")
        }
        words = {
            "judged": "channels that fit each other",
            "unsided": "channels that fit in size, CHECK left and right",
            "stated": "channels in the unit that the file states, not judged",
            "assumed": "channels whose unit is assumed: CHECK",
            "open": "channels left open, with the reason in the map",
        }
        lines = [f"wrote {self.map_path} and {self.vehicle_path}"]
        lines += [f"  {words[status]}: {', '.join(dict.fromkeys(found))}" for status, found in counts.items() if found]
        return "\n".join([*lines, "next:", *(f"  {n}. {step}" for n, step in enumerate(self.next_steps, 1))])

    def to_mapping(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "map": str(self.map_path),
            "vehicle": str(self.vehicle_path),
            "channels": [
                {"channel": s.channel, "sources": list(s.sources), "status": s.status, "reason": s.reason}
                for s in self.draft.suggestions
            ],
            "next": list(self.next_steps),
        }


def _to_record(missing: Sequence[str], mapped: set[str]) -> set[str]:
    """Return the channels without which a log makes no drive; the others are derived once these are there."""
    lost = set(missing)
    for channel in reversed(missing):
        # What is derived may take another channel that is derived.
        derived = derivations_for(missing, mapped | lost - {channel})
        if any(channel in DERIVATIONS[name].makes for name in derived):
            lost.remove(channel)
    return lost


def init_project(
    logs: Sequence[str | Path],
    folder: str | Path,
    *,
    together: bool = False,
    row_rate: float | None = None,
    message_paths: Sequence[str | Path] = (),
) -> InitResult:
    """Write a drafted map and a vehicle file to fill in.

    Parameters
    ----------
    logs : sequence of path-like
        One recording, several of one car, or with `together` the files of one drive; folders, globs and addresses
        as `find_sources` takes them.
    folder : path-like
        Made when it does not exist.
    together : bool
        Several files make one drive; without it all are drafted, and one map is made for them.
    row_rate : float, optional
        Of a table without a column of time [Hz].
    message_paths : sequence of path-like
        Folders of ``.msg`` files, and CAN databases.

    Raises
    ------
    SplitError
        If the recording cannot be read or has another form than a column for each signal, or one of the two files
        exists.
    """
    folder = Path(folder)
    targets = folder / "map.yaml", folder / "vehicle.yaml"
    for target in targets:
        if target.exists():
            advice = "Name another folder with -o, or ingest the logs of one car with the map and vehicle file it has."
            raise SplitError("exists already", where=str(target), advice=advice)
    sources = find_sources(logs)
    drafts: dict[str, Draft] = {}
    recorded: dict[str, list[str]] = {}
    empty: list[str] = []
    names = []
    for parts in [sources] if together else [[source] for source in sources]:
        with contextlib.ExitStack() as stack:
            paths = enter_all(parts, stack)
            if len(sources) > len(parts) and paths[0].is_file() and holds_titles_alone(paths[0]):
                empty.append(f"{parts[0].name} holds titles alone and is left out.")
                continue
            recording = open_logs(paths if together else paths[0], message_paths)
            drafts[parts[0].address] = draft_map(recording, row_rate=row_rate)
            recorded[parts[0].address] = [info.name for info in recording.channels()]
            names.append(recording.name)
    if not drafts:
        raise LogError("holds titles alone", where=str(logs[0]), advice="Record it again.")
    draft, differences = agreed_draft(drafts, recorded)
    differences = (*empty, *differences)
    name = ", ".join(names)
    if draft.hints and all(s.status == "open" for s in draft.suggestions):
        # Files would stand in the way of the next attempt, with the log in another form.
        raise SplitError("no channel was recognised", where=name, advice=" ".join(draft.hints))
    folder.parent.mkdir(parents=True, exist_ok=True)
    # Both or none: a map alone would stand in the way of the next attempt.
    with atomic_directory(folder) as temporary:
        (temporary / "map.yaml").write_text(render_draft(draft, name) + "\n", encoding="utf-8")
        (temporary / "vehicle.yaml").write_text(VEHICLE_TEMPLATE, encoding="utf-8")
    shown = " ".join(shlex.quote(typed_address(log)) for log in logs) + (" --together" if together else "")
    databases = [f" --dbc {shlex.quote(str(p))}" for p in message_paths if Path(p).is_file()]
    rate = f" --row-rate {row_rate:g}" if row_rate is not None else ""
    first = Path(plain_name(sources[0].name))
    made = f"{first.stem}{'_drive' * (first.suffix == '.parquet')}.parquet"
    made = shlex.quote(f"{first.stem}_drives" if len(names) > 1 else made)
    return InitResult(*targets, draft, shown + "".join(databases) + rate, made, differences)
