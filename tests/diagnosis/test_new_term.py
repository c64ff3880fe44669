"""A term of the diagnosis is one file: written into a folder of its own, it is found, fitted, named and said."""

import sys

import pytest

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.statement.separation import separation
from split_cli.vehicle import effects
from split_cli.workflows.report.headline import finding_headline
from tests.diagnosis.recordings import driven, noisy
from tests.factories import road_car

SOURCE = '''
"""A term of this test alone."""

from typing import ClassVar

from split_cli.vehicle.effects.search import Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import amount

__all__ = ["TorqueSteer"]


class TorqueSteer(Term):
    """Torque turns the front wheels: delta + angle T/T_max."""

    id = "torque_steer"
    titles: ClassVar = {"": "Torque steers"}
    units: ClassVar = {"angle": "rad"}
    neutral: ClassVar = {"angle": 0.0}
    family = "steering"
    needs: ClassVar = frozenset({"torque", "torque changes"})
    mimics: ClassVar = (Mimic("steer_offset", "one torque", "turns with and without torque"),)

    @classmethod
    def search(cls, vehicle, course, variant=""):
        return Search({"angle": Range(-0.1, 0.1, 0.0005)}, ({"angle": 0.002},))

    @classmethod
    def statement(cls, p, variant=""):
        return f"full torque turns the front wheels by {amount(p['angle'])}"

    def actuate(self, flow):
        flow.delta = flow.delta + self.parameters["angle"] * flow.T / flow.vehicle.max_torque
'''


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """Return the term, its file put beside the package's own."""
    package = tmp_path / "toy_terms"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "torque_steer.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = effects.find_terms("toy_terms")
    assert list(found) == ["torque_steer"]
    monkeypatch.setitem(effects.CATALOGUE, "torque_steer", found["torque_steer"])
    yield found["torque_steer"]
    for name in ("toy_terms", "toy_terms.torque_steer"):
        sys.modules.pop(name)


def test_every_term_of_the_package_is_found_in_its_files():
    assert effects.find_terms() == effects.CATALOGUE
    assert len(effects.CATALOGUE) >= 28


def test_a_new_file_is_diagnosed_and_said_in_its_own_words(toy):
    real = noisy(driven(71, (toy({"angle": 0.02}),), runs=8, seconds=8.0, spaced=9.0), 571, position=0.01)
    said = diagnose([real], road_car(), improved=False)
    (finding,) = said.findings
    assert finding.term == "torque_steer"
    low, high = finding.parameters["angle"].interval_95
    assert low <= 0.02 <= high and high - low < 0.01
    assert finding.sentence.startswith("In reality full torque turns the front wheels by 0.0")
    assert finding_headline(finding).startswith("Torque steers: ")
    # A car without it shows from which size on it would have been named; an identified effect has its interval.
    sound = noisy(driven(71, runs=8, seconds=8.0, spaced=9.0), 571, position=0.01)
    limits = {one.term: one.parameters for one in diagnose([sound], road_car(), improved=False).detectable}
    assert 0.0 < limits["torque_steer"]["angle"][0] < 0.02 and "torque_steer" not in {
        one.term for one in said.detectable
    }
    assert separation("torque_steer", "", "steer_offset").hint == "turns with and without torque"
