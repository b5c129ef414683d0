"""`follower models` says what is there, fetches, and ends with a code that scripts can use."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from typer.testing import CliRunner

import follower_vision.models.store as store_module
from follower.apps.models import models_app
from follower_vision.models import ModelFile, Purpose, VisionModel

CONTENT = b"weights" * 1000


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "served").mkdir()
    (tmp_path / "served" / "tiny.onnx").write_bytes(CONTENT)
    handler = partial(QuietHandler, directory=str(tmp_path / "served"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/tiny.onnx"
        server.shutdown()
        thread.join()


@pytest.fixture
def folder(tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for the networks of a small table: one at an address, one without."""

    def model(name: str, *addresses: str, usual: bool = False) -> VisionModel:
        file = ModelFile(
            f"{name}.onnx", len(CONTENT), hashlib.sha256(CONTENT).hexdigest(), addresses
        )
        return VisionModel(name, Purpose.TRACKER, "a test", "CC0-1.0", "us", (file,), usual=usual)

    table = (model("tiny", address, usual=True), model("own"))
    monkeypatch.setattr(store_module.ModelStore.__init__, "__defaults__", (table, tmp_path))
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(models_app, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def test_list_shows_what_is_there(folder: Path) -> None:
    code, out, _ = run("list")
    assert code == 0
    assert "tiny" in out
    assert "CC0-1.0" in out
    assert "yes" not in out
    folder.mkdir()
    (folder / "tiny.onnx").write_bytes(CONTENT)
    assert "yes" in run("list")[1]


@pytest.mark.parametrize("arguments", [["tiny"], [], ["--all"]])
def test_pull_fetches_and_prints_the_paths(folder: Path, arguments: list[str]) -> None:
    code, out, error = run("pull", *arguments)
    assert (code, error) == (0, "")
    assert out == f"{folder / 'tiny.onnx'}\n"
    assert (folder / "tiny.onnx").read_bytes() == CONTENT
    assert run("path", "tiny") == (0, f"{folder / 'tiny.onnx'}\n", "")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["pull", "own"], "own.onnx has no address; put your own copy at"),
        (["pull", "other"], "there is no network 'other'; there are tiny, own"),
        (["path", "tiny"], "`follower models pull tiny` fetches it"),
        (["verify", "other"], "there is no network 'other'"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_errors_are_one_line_and_exit_code_2(
    run_command: Callable[..., tuple[int, str, str]], arguments: list[str], said: str
) -> None:
    code, out, error = run_command("models", *arguments)
    assert (code, out) == (2, "")
    assert error.startswith("follower: ")
    assert said in error
    assert error.count("\n") == 1


def test_path_alone_is_the_folder(folder: Path, tmp_path: Path) -> None:
    assert run("path") == (0, f"{folder}\n", "")
    assert run("path", "--folder", str(tmp_path)) == (0, f"{tmp_path}\n", "")


def test_verify_tells_good_from_bad(folder: Path) -> None:
    assert run("verify") == (0, "", "")
    run("pull")
    assert run("verify") == (0, "good  tiny  tiny.onnx\n", "")
    (folder / "tiny.onnx").write_bytes(CONTENT[::-1])
    assert run("verify") == (1, "wrong  tiny  tiny.onnx\n", "")
    assert run("verify", "own") == (1, "missing  own  own.onnx\n", "")
