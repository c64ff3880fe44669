"""Sentences on pages: signs of print, and no line that ends between a number and its unit."""

import pytest

from split_cli.vehicle.effects import CATALOGUE
from split_cli.workflows.report.markup import notes_section
from split_cli.workflows.report.words import heading, prose, term_title


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("torque -3,206 to -903 N m.", "torque −3,206 to −903\u00a0N\u00a0m."),
        ("hold only 76 % of 50 ms at 1.5 m/s^2", "hold only 76\u00a0% of 50\u00a0ms at 1.5\u00a0m/s²"),
        ("2 s and 3 g-forces, 4 m-wide, 1.2 deg +- 0.1", "2\u00a0s and 3 g-forces, 4 m-wide, 1.2\u00a0deg ± 0.1"),
        ("write `offset: -0.03 m/s^2` at 1 m", "write <code>offset: -0.03 m/s^2</code> at 1\u00a0m"),
        ("a lone ` and -1 <b>", "a lone ` and −1 &lt;b&gt;"),
        ("lap-2.parquet of 2026-05-04", "lap-2.parquet of 2026-05-04"),
    ],
)
def test_a_sentence_is_typeset_and_what_it_quotes_is_not(said, shown):
    assert prose(said) == shown
    assert "`" in said or heading(said) == shown


def test_a_note_that_a_command_prints_without_an_end_has_one_on_a_page():
    """`its error is 89 % of the nominal model's` looked cut off."""
    page = notes_section(["its error is 89 % of the nominal model's", "Done."], "Notes")
    assert "model&#x27;s.</li>" in page and "Done.</li>" in page


def test_every_variant_is_called_by_what_it_is():
    """A card offered "Drive lag (changed)", of which no page said what had changed."""
    assert term_title("drive_lag") == "Drive lag"
    assert term_title("drive_lag", "changed") == "Drive lag, longer or shorter than the simulation's"
    assert term_title("cg_shift", "degressive").startswith("CG shift, with tyre forces less than")
    for term, kind in CATALOGUE.items():
        missing = {one for one in kind.variants if one} - set(kind.variant_words)
        assert not missing, f"{term}: {missing}"
        titles = [term_title(term, one) for one in kind.variants]
        assert len(set(titles)) == len(titles)
