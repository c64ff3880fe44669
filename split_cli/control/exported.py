"""The residual of an export's CasADi file: what a controller has that knows nothing of this program."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from split_cli.control.generated import Batch, as_compiled_c
from split_cli.control.grip import learned_grip
from split_cli.control.policy import LEAST_KNOWN
from split_cli.control.residual import Residual, ResidualValues
from split_cli.errors import ExportError, SetError
from split_cli.export.verify import read_manifest
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.parameters import Vehicle, vehicle_from_mapping


class ExportedResidual(Residual):
    """What ``NAME.casadi`` of an export says, and its derivative by CasADi; nothing else of the set is read.

    Parameters
    ----------
    folder : Path
        Of `split export --target casadi`.
    vehicle : Vehicle
        Of the file that the set was trained with; the controller drives with `vehicle` of this object.

    Raises
    ------
    ExportError
        If there is no export with CasADi's functions.
    SetError
        If the export is of another vehicle.

    Attributes
    ----------
    vehicle : Vehicle
        The one given, with the effects that training found beyond its file: the function corrects that model.

    Notes
    -----
    The prior's variance is what the function answers infinitely far from its points.
    """

    def __init__(self, folder: Path, vehicle: Vehicle) -> None:
        manifest = read_manifest(folder)
        self.name, self.predictor = manifest["name"], manifest["predictor"]
        file = folder / f"{self.name}.casadi"
        if not file.is_file():
            what = f"holds no CasADi function: {file.name} is missing"
            raise ExportError(what, where=str(folder), advice="Export the set with --target casadi.")
        terms = {name.partition(".")[0] for name in manifest["features"] if "." in name}
        lacking = sorted(terms - {effect.term for effect in vehicle.effects})
        if lacking:
            what = f"has states of {', '.join(lacking)} as features, which {vehicle.name} lacks"
            advice = "Name the set itself in place of its export: the set brings the term."
            raise SetError(what, where=str(folder), advice=advice)
        self.vehicle = _with_found_effects(vehicle, manifest, folder)
        if manifest["vehicle_digest"] != self.vehicle.digest():
            what = f"was exported for another vehicle than {vehicle.name}"
            advice = "Name the vehicle file the set was trained with, or export the set again with this version."
            raise SetError(what, where=str(folder), advice=advice)
        try:
            predict = casadi.Function.load(str(file))
        except RuntimeError as error:
            advice = "Export the set again."
            raise ExportError("is damaged: CasADi cannot read it", where=str(file), advice=advice) from error
        self.features = FeatureSet(tuple(manifest["features"]))
        z = casadi.MX.sym("z", predict.size1_in(0))
        mean, variance = predict(z)
        outputs = [casadi.densify(one) for one in (mean, variance, casadi.jacobian(mean, z))]
        self._function, self.not_compiled = as_compiled_c(casadi.Function("exported", [z], outputs))
        self._prior = predict(np.full(predict.size1_in(0), np.inf))[1].full().ravel()
        self._batches: dict[int, Batch] = {}

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        if len(z) not in self._batches:
            self._batches[len(z)] = Batch(self._function, len(z))
        mean, variance, slope = self._batches[len(z)](z)
        return ResidualValues.of(mean[:, :, 0], slope, variance[:, :, 0], self._prior)

    def grip(self, vehicle: Vehicle, largest: float) -> np.ndarray:
        """Return the peak of front and rear over the vehicle file's, shape (2,), as the function tells it.

        Parameters
        ----------
        largest : float
            Slip angle up to which it is asked [rad]; the other features are zero.

        Notes
        -----
        `learned_grip` of its answers in place of labels, where it knows most of v_y and r.
        """
        names = self.features.names
        if not {"alpha_f", "alpha_r"} <= set(names):
            return np.ones(2)
        angles = np.linspace(-largest, largest, 41)
        z = np.zeros((len(angles) ** 2, len(names)))
        pairs = np.meshgrid(angles, angles)
        z[:, names.index("alpha_f")], z[:, names.index("alpha_r")] = (one.ravel() for one in pairs)
        found = self.of_data(z)
        known = (found.knowledge[:, 1:] > LEAST_KNOWN).all(axis=1)
        return learned_grip(vehicle, self.features, z[known], found.mean[known])


def _with_found_effects(vehicle: Vehicle, manifest: Mapping[str, Any], folder: Path) -> Vehicle:
    """Return a vehicle with the lags that training found beyond its file, as the manifest of an export names them."""
    count = int(manifest.get("found_effects", 0))
    if not count:
        return vehicle
    exported = vehicle_from_mapping(manifest["vehicle"], where=f"{folder}: manifest.json")
    return replace(vehicle, effects=(*vehicle.effects, *exported.effects[-count:]))
