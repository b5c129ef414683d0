"""The documentation: its size, its links, and the site that `make docs` builds."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
KINDS = ("tutorials", "how-to", "reference", "explanation", "decisions")
LINK = re.compile(r"\]\(([^)#\s]+)")


def words(*pages: Path) -> int:
    return sum(len(page.read_text("utf-8").split()) for page in pages)


def test_the_pages_are_short_and_each_is_of_one_kind() -> None:
    pages = sorted(DOCS.rglob("*.md"))
    assert words(*pages) <= 30_000
    assert words(DOCS / "ARCHITECTURE.md") <= 1_200
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 150
    loose = {page.name for page in pages if page.parent == DOCS}
    assert loose == {"index.md", "ARCHITECTURE.md"}
    assert {page.parent.name for page in pages if page.parent != DOCS} == set(KINDS)


def test_each_decision_has_its_evidence_and_is_listed() -> None:
    listed = (DOCS / "ARCHITECTURE.md").read_text("utf-8")
    decisions = sorted((DOCS / "decisions").glob("*.md"))
    assert [page.name[:4] for page in decisions] == [f"{n + 1:04}" for n in range(len(decisions))]
    for page in decisions:
        text = page.read_text("utf-8")
        assert text.startswith(f"# {page.name[:4]} ")
        assert "**Evidence.**" in text
        assert len(text.split()) <= 200
        assert f"](decisions/{page.name})" in listed


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_beside_the_site_lead_somewhere(name: str) -> None:
    links = LINK.findall((ROOT / name).read_text("utf-8"))
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def mkdocs(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", *options],
        cwd=folder,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


@pytest.mark.slow
def test_the_site_is_built_with_pictures_and_search(tmp_path: Path) -> None:
    built = mkdocs(ROOT, "--site-dir", str(tmp_path))
    assert built.returncode == 0, built.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) == len(list(DOCS.rglob("*.md"))) + 1, "and 404.html"
    assert {path.name for path in (DOCS / "pictures").iterdir()} == {
        path.name for path in (tmp_path / "pictures").iterdir()
    }
    assert "FusionTracker" in (tmp_path / "reference" / "python-api.html").read_text("utf-8")
    assert (tmp_path / "search" / "search_index.js").stat().st_size > 100_000
    assert not (tmp_path / "hooks").exists()


def small_site(folder: Path, page: str) -> Path:
    """Make a site of our configuration with one page and one module of API."""
    hooks = [str(DOCS / "hooks" / f"{name}.py") for name in HOOKS]
    (folder / "mkdocs.yml").write_text(
        f"INHERIT: {ROOT / 'mkdocs.yml'}\nhooks: {hooks}\n"
        "nav: [index.md, reference/python-api.md]\n",
        "utf-8",
    )
    (folder / "docs" / "reference").mkdir(parents=True)
    (folder / "docs" / "index.md").write_text(page, "utf-8")
    (folder / "docs" / "reference" / "python-api.md").write_text(
        "# API\n\n::: bare.Bare\n", "utf-8"
    )
    (folder / "bare.py").write_text('class Bare:\n    """Has a docstring."""\n', "utf-8")
    return folder


HOOKS = ("public_docstrings", "nothing_from_outside")


@pytest.mark.slow
def test_a_site_without_faults_passes(tmp_path: Path) -> None:
    built = mkdocs(small_site(tmp_path, "# Home\n\n[API](reference/python-api.md)\n"))
    assert built.returncode == 0, built.stderr


@pytest.mark.slow
def test_a_dead_link_a_missing_docstring_and_a_script_from_outside_each_fail(
    tmp_path: Path,
) -> None:
    page = '# Home\n\n[gone](gone.md) [away](#away)\n\n<script src="https://cdn.example/x.js"></script>\n'
    folder = small_site(tmp_path, page)
    (folder / "bare.py").write_text("class Bare:\n    def run(self) -> None: ...\n", "utf-8")
    (folder / "docs" / "unlisted.md").write_text("# In no menu\n", "utf-8")
    built = mkdocs(folder)
    assert built.returncode != 0
    for fault in (
        "'gone.md'",
        "'#away'",
        "unlisted.md",
        "bare.Bare has no docstring",
        "bare.Bare.run has no docstring",
        "index.html loads https://cdn.example/x.js",
    ):
        assert fault in built.stderr, built.stderr


def hook(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / "hooks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_a_page_loads_is_told_from_what_a_reader_follows() -> None:
    loaded = hook("nothing_from_outside").loaded_from_outside
    assert list(loaded('<a href="https://px4.io">PX4</a><img src="pictures/a.png">')) == []
    assert list(loaded('<link rel="canonical" href="https://a.example">')) == []
    assert list(loaded('<link rel="stylesheet" href="//fonts.example/a.css">')) != []
    assert list(loaded('<img src="https://a.example/a.png">')) != []


def test_fields_count_as_documented_in_their_class_or_by_themselves(tmp_path: Path) -> None:
    code = (
        'class Gain:\n    """A gain.\n\n    Attributes:\n        kp: per second.\n    """\n\n'
        '    kp: float\n    ki: float = 0.0\n    """Per second squared."""\n    kd: float = 0.0\n'
        "    _hidden: float = 0.0\n\n    @property\n    def all(self) -> float: ...\n"
    )
    (tmp_path / "gains.py").write_text(code, "utf-8")
    undocumented = hook("public_docstrings").undocumented
    assert list(undocumented(["gains.Gain"], tmp_path)) == ["gains.Gain.kd", "gains.Gain.all"]
    with pytest.raises(FileNotFoundError, match=r"there is no module losses"):
        list(undocumented(["losses.Loss"], tmp_path))
