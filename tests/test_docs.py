"""What the documentation shows is what the program accepts."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from split_cli.logs.signal_map import map_from_mapping
from split_cli.vehicle.parameters import vehicle_from_mapping
from split_cli.vehicle.single_track import SingleTrack

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("docs/**/*.md"), ROOT / "README.md", ROOT / "sample_logs" / "README.md"])


def yaml_blocks(page: str) -> list[dict]:
    text = (ROOT / "docs" / page).read_text()
    return [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, flags=re.S)]


def test_the_vehicle_file_of_the_docs_is_a_vehicle_with_a_working_effect():
    content = next(block for block in yaml_blocks("formats.md") if "mass" in block)
    car = vehicle_from_mapping(content)
    plain = SingleTrack(car, terms=())
    # 0.08 N/(m/s)^2 of added drag at 30 m/s on 1500 kg.
    loss = (
        plain.velocity_derivative(30.0, 0.0, 0.0, 0.0, 0.0)[0]
        - SingleTrack(car).velocity_derivative(30.0, 0.0, 0.0, 0.0, 0.0)[0]
    )
    assert loss == pytest.approx(0.08 * 900.0 / 1500.0)


def test_the_signal_map_of_the_docs_is_a_map():
    content = next(block for block in yaml_blocks("formats.md") if "channels" in block)
    read = map_from_mapping(content)
    assert read.channel("delta").sources[0].delay == pytest.approx(0.04)
    assert len(read.channel("T").sources) == 3


def anchors(page: Path) -> set[str]:
    """Return what a link to a place on a page may name: its titles as GitHub writes them, and anchors of HTML."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    titles = re.findall(r"^#+ (.*)$", text, flags=re.M)
    named = {re.sub(r"[^\w\s-]", "", title.lower()).strip().replace(" ", "-") for title in titles}
    return named | set(re.findall(r'id="([^"]+)"', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_between_pages_lead_somewhere(page):
    for target, place in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", page.read_text()):
        if "://" not in target:
            other = page.parent / target if target else page
            assert other.exists(), f"{page.name} links to {target}"
            if place and other.suffix == ".md":
                assert place in anchors(other), f"{page.name} links to {target}#{place}"


def test_commits_that_pages_name_are_in_the_history():
    """Commits of other projects stand behind the words "their commit". A shallow clone cannot tell."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    if git("rev-parse", "--show-toplevel") != str(ROOT) or git("rev-parse", "--is-shallow-repository") != "false":
        pytest.skip("no whole history here")
    known = {commit[:7] for commit in git("rev-list", "HEAD").split()}
    named = re.compile(r"(?<!their commit )\b(?=\d*[a-f])(?=[a-f]*\d)[0-9a-f]{7}\b")
    unknown = {
        f"{page.relative_to(ROOT)}: {commit}"
        for page in [*PAGES, ROOT / "CHANGELOG.md"]
        for commit in named.findall(page.read_text(encoding="utf-8"))
        if commit not in known
    }
    assert not unknown


def test_counts_of_the_readme_stand_on_the_pages_that_it_links():
    """Tables of the README repeat sums of other pages, and were left behind when tests were added there."""
    rows = re.findall(r"^\| .* \|$", (ROOT / "README.md").read_text(), flags=re.M)
    rows = [row for row in rows if re.search(r"\d of \d.*\]\(docs/\w+\.md", row)]
    assert len(rows) >= 7
    for row in rows:
        page = re.search(r"\]\((docs/\w+\.md)", row.rsplit("|", 2)[1]).group(1)
        text = (ROOT / page).read_text().replace("*", "")
        for count in re.findall(r"[\d,]+ of [\d,]*\d", row):
            assert re.search(rf"(?<![\d,]){count}(?![\d,]*\d)", text), f"{page} does not say {count}: {row}"
