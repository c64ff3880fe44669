"""`diagnosis.json`: a diagnosis in the form of its JSON schema."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from split_cli import __version__
from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import Detectable, Diagnosis, Finding, Lead, Location, ParameterEstimate
from split_cli.files import json_ready

#: Names of the vehicle file with the findings: accepted, and rejected. One is written if there are findings of the car.
VEHICLES = ("vehicle_corrected.yaml", "vehicle_rejected.yaml")


def vehicle_name(diagnosis: Diagnosis) -> str | None:
    """Return the name of the vehicle file with the findings, see `VEHICLES`; None without findings of the car."""
    if not any(finding.exported for finding in diagnosis.findings):
        return None
    corrected = diagnosis.corrected_vehicle
    return VEHICLES[0] if corrected is None or corrected.accepted else VEHICLES[1]


def read_schema() -> dict[str, Any]:
    """Return the JSON schema that ships with the package."""
    return json.loads(files("split_cli.diagnosis").joinpath("diagnosis.schema.json").read_text(encoding="utf-8"))


def diagnosis_to_text(diagnosis: Diagnosis) -> str:
    """Return the content of `diagnosis.json`."""
    return json.dumps(diagnosis_to_mapping(diagnosis), indent=2, allow_nan=False) + "\n"


def diagnosis_to_mapping(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what `diagnosis.json` holds."""
    return {
        "schema": "split-diagnosis/1",
        "version": __version__,
        "verdict": diagnosis.verdict,
        "p_value": diagnosis.p_value,
        "compared_share": diagnosis.compared_share,
        "not_judged": list(diagnosis.not_judged),
        "location": _location(diagnosis.location),
        "findings": [_finding(finding) for finding in diagnosis.findings],
        "unexplained": diagnosis.unexplained,
        "improvement": _improvement(diagnosis.improvement),
        "corrected_vehicle": _corrected(diagnosis),
        "leads": [_lead(one) for one in diagnosis.leads],
        "detectable": [_detectable(one) for one in diagnosis.detectable],
        "inputs": [{"name": f.name, "sha256": f.sha256, "role": f.role} for f in diagnosis.inputs],
        "settings": json_ready(diagnosis.settings),
    }


def _corrected(diagnosis: Diagnosis) -> dict[str, Any] | None:
    corrected = diagnosis.corrected_vehicle
    if corrected is None:
        return None
    states = [{**asdict(one), "worse": one.is_worse} for one in corrected.states]
    return {
        "file": vehicle_name(diagnosis),
        "accepted": corrected.accepted,
        "values": json_ready(corrected.values),
        "further": [asdict(one) for one in corrected.further],
        "states": json_ready(states),
    }


def _location(location: Location | None) -> dict[str, Any] | None:
    if location is None:
        return None
    place = location.place
    return {
        "forces": dict(location.forces),
        "depends_on": [{"variable": name, "score": score} for name, score in location.depends_on],
        "region": {name: list(limits) for name, limits in location.region.items()},
        "place": None
        if place is None
        else {
            "s_start": place.s_start,
            "s_end": place.s_end,
            "lap_length": place.lap_length,
            "reference": place.reference,
            "x": place.x,
            "y": place.y,
        },
        "time": None if location.time is None else list(location.time),
        "share_of_gap": location.share_of_gap,
        "share_of_samples": location.share_of_samples,
    }


def _parameters(parameters: Mapping[str, ParameterEstimate]) -> dict[str, Any]:
    return {
        name: {"value": p.value, "std_error": p.std_error, "unit": p.unit, "interval_95": list(p.interval_95)}
        for name, p in parameters.items()
    }


def _lead(lead: Lead) -> dict[str, Any]:
    return {
        "term": lead.term,
        "variant": lead.variant,
        "parameters": _parameters(lead.parameters),
        "limits": {name: list(limits) for name, limits in lead.limits.items()},
        "share": lead.share,
        "instead": list(lead.instead),
        "sentence": lead.sentence,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "term": finding.term,
        "parameters": _parameters(finding.parameters),
        "gap_explained": finding.gap_explained,
        "alternatives": list(finding.alternatives),
        "sentence": finding.sentence,
        "combination": None if finding.combination is None else json_ready(asdict(finding.combination)),
    }


def _detectable(one: Detectable) -> dict[str, Any]:
    parameters = {name: {"value": value, "unit": unit} for name, (value, unit) in one.parameters.items()}
    return {"term": one.term, "parameters": parameters}


def _improvement(improvement: Improvement | None) -> dict[str, Any] | None:
    if improvement is None:
        return None
    return {
        "holdout_rmse_before": list(improvement.before),
        "holdout_rmse_physics": list(improvement.physics),
        "holdout_rmse_after": list(improvement.after),
        "persistence": list(improvement.persistence),
        "noise_floor": None if improvement.noise_floor is None else list(improvement.noise_floor),
        "confidence": json_ready({**improvement.confidence, **_removed(improvement)}),
        "simulation_part": json_ready(improvement.simulation_part),
        "split_trust": json_ready(improvement.trust),
        "rollouts": [_rollout(one) for one in improvement.rollouts],
    }


def _rollout(one: HorizonErrors) -> dict[str, Any]:
    stages = ("before", "physics", "split_only", "after", "persistence", "noise_floor")
    errors = {stage: list(getattr(one, stage)) for stage in stages}
    rest = {"mean_error": json_ready(one.mean), "confidence": json_ready(one.confidence)}
    return {"horizon": one.horizon, "starts": one.starts, **errors, **rest}


def _removed(improvement: Improvement) -> dict[str, Any]:
    """Return the removed shares of the error above the noise floor; the schema allows further fields here."""
    if not improvement.removed:
        return {}
    shares = {
        stage: None if share is None else {"share": share[0], "interval_95": list(share[1:])}
        for stage, share in improvement.removed.items()
    }
    return {"improvable_removed": shares}
