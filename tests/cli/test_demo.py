"""`split demo`: its steps feed each other, and the last one diagnoses the bundled pair."""

import json
from pathlib import Path

import click

from split_cli.cli.main import group
from split_cli.workflows.demo import closing_words, demo_steps, find_samples


def test_every_file_a_step_reads_is_bundled_or_written_before(sample_logs, tmp_path):
    written = set()
    for step in demo_steps(sample_logs, tmp_path):
        outputs = {step.arguments[k + 1] for k, a in enumerate(step.arguments) if a in ("-o", "--out")}
        for argument in step.arguments:
            if argument.startswith(str(tmp_path)) and argument not in outputs:
                assert argument in written
            elif argument.startswith(str(sample_logs)):
                assert (sample_logs / argument).is_file()
        written |= outputs


def test_a_folder_whose_name_begins_with_a_hyphen_is_no_option(sample_logs, tmp_path):
    """`split demo -o -x` had ended at its third step, with a usage of `split train`."""
    for step in demo_steps(sample_logs, Path("-x")):
        assert not any(argument.startswith("-x") for argument in step.arguments)
    assert any(argument == "./-x/road_car.split" for argument in demo_steps(sample_logs, Path("-x"))[2].arguments)


def test_the_last_step_is_a_diagnosis_with_options_that_exist(sample_logs, tmp_path):
    """What it finds on the pair is in tests/test_notebook.py, which diagnoses the same two drives."""
    command, *arguments = demo_steps(find_samples(sample_logs), tmp_path)[-1].arguments
    assert command == "diagnose"
    diagnose = group.get_command(click.Context(group), command)
    with diagnose.make_context(command, list(arguments)) as context:
        assert [Path(path).name for path in context.params["real"]] == ["road_pair_real.parquet"]
        assert [Path(path).name for path in context.params["simulated"]] == ["road_pair_sim.parquet"]
        assert Path(context.params["output"]) == tmp_path / "diagnosis"


def test_the_last_words_name_it_and_the_report(tmp_path):
    folder = tmp_path / "diagnosis"
    folder.mkdir()
    told = {"verdict": "mismatch", "findings": [{"term": "drive_gain"}]}
    (folder / "diagnosis.json").write_text(json.dumps(told), encoding="utf-8")
    words = closing_words(tmp_path)
    assert "mismatch" in words and "drive_gain" in words
    assert (folder / "report.html").as_uri() in words
