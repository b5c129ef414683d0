"""The networks' folder: fetched over a real connection, verified, whole or not at all."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from real_data import DATA, needs_data

from follower_vision.detection import detector_names, make_detector
from follower_vision.models import (
    MODELS,
    DownloadError,
    FileState,
    ModelFile,
    ModelStore,
    Purpose,
    VisionModel,
    default_folder,
    download,
)
from follower_vision.models.store import EMBEDDED_FOLDER
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.registry import make_tracker

CONTENT = bytes(range(256)) * 2000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


class Server(ThreadingHTTPServer):
    """Serves CONTENT, with what goes wrong on networks on request."""

    daemon_threads = True
    content = CONTENT
    ranges = True
    breaks_after: int | None = None
    stalls = False
    status = 200
    requests: list[str | None]

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/network.onnx"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, wanted = self.server, self.headers.get("Range")
        server.requests.append(wanted)
        if server.status != 200:
            self.send_error(server.status)
            return
        start = int(re.fullmatch(r"bytes=(\d+)-", wanted).group(1)) if wanted else 0
        start = start if server.ranges else 0
        if start >= len(server.content):
            self.send_error(416)
            return
        self._send(start)

    def _send(self, start: int) -> None:
        body = self.server.content[start:]
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(body)))
        if start:
            last = len(self.server.content) - 1
            self.send_header("Content-Range", f"bytes {start}-{last}/{last + 1}")
        self.end_headers()
        self.wfile.write(body[: self.server.breaks_after])
        if self.server.stalls:
            self.wfile.flush()
            threading.Event().wait(1.0)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(("127.0.0.1", 0), Handler) as running:
        running.requests = []
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def model_of(*files: ModelFile, name: str = "tiny") -> VisionModel:
    return VisionModel(name, Purpose.TRACKER, "a test", "CC0-1.0", "nobody", files)


def tiny(*addresses: str, sha256: str = SHA256) -> VisionModel:
    return model_of(ModelFile("network.onnx", len(CONTENT), sha256, addresses))


def store_of(folder: Path, *models: VisionModel) -> ModelStore:
    return ModelStore(folder / "models", models)


def only_file(folder: Path) -> Path:
    (path,) = (folder / "models").iterdir()
    return path


def test_pull_fetches_verifies_and_tells_progress(server: Server, tmp_path: Path) -> None:
    model, told = tiny(server.address), []
    store = store_of(tmp_path, model)
    assert not store.is_present(model)
    assert store.verify(model) == {"network.onnx": FileState.MISSING}
    (path,) = store.pull(model, lambda done, wanted: told.append((done, wanted)))
    assert path == only_file(tmp_path) == store.file("network.onnx")
    assert path.read_bytes() == CONTENT
    assert store.verify(model) == {"network.onnx": FileState.GOOD}
    assert told == sorted(told)
    assert len(told) > 3
    assert told[-1] == (len(CONTENT), len(CONTENT))


def test_what_is_there_is_not_fetched_again(server: Server, tmp_path: Path) -> None:
    model = tiny(server.address)
    store = store_of(tmp_path, model)
    store.pull(model)
    store.pull(model)
    assert len(server.requests) == 1


def test_a_damaged_file_is_fetched_anew(server: Server, tmp_path: Path) -> None:
    model = tiny(server.address)
    store = store_of(tmp_path, model)
    (path,) = store.pull(model)
    path.write_bytes(CONTENT[:-1] + b"x")
    assert store.verify(model) == {"network.onnx": FileState.WRONG}
    store.pull(model)
    assert store.verify(model) == {"network.onnx": FileState.GOOD}


def test_several_files_are_told_as_one(server: Server, tmp_path: Path) -> None:
    files = [ModelFile(f"{n}.onnx", len(CONTENT), SHA256, (server.address,)) for n in "ab"]
    model, told = model_of(*files), []
    store = store_of(tmp_path, model)
    paths = store.pull(model, lambda done, wanted: told.append((done, wanted)))
    assert [path.name for path in paths] == ["a.onnx", "b.onnx"]
    assert told == sorted(told)
    assert told[-1] == (2 * len(CONTENT), 2 * len(CONTENT))


def test_a_broken_transfer_goes_on_where_it_broke(server: Server, tmp_path: Path) -> None:
    server.breaks_after = len(CONTENT) // 3
    model = tiny(server.address)
    store_of(tmp_path, model).pull(model)
    assert only_file(tmp_path).read_bytes() == CONTENT
    third = server.breaks_after
    assert server.requests == [
        None,
        f"bytes={third}-",
        f"bytes={2 * third}-",
        f"bytes={3 * third}-",
    ]


def test_a_transfer_that_breaks_too_often_is_kept_for_the_next_pull(
    server: Server, tmp_path: Path
) -> None:
    server.breaks_after = 1000
    model = tiny(server.address)
    store = store_of(tmp_path, model)
    with pytest.raises(DownloadError, match=r"network\.onnx: .* broke off.*; try again") as caught:
        store.pull(model)
    assert "\n" not in str(caught.value)
    assert not store.is_present(model)
    assert only_file(tmp_path).name == "network.onnx.part"
    server.breaks_after = None
    store.pull(model)
    assert server.requests[-1] == "bytes=5000-"
    assert only_file(tmp_path).read_bytes() == CONTENT


@pytest.mark.parametrize("ranges", [True, False], ids=["", "a server without ranges"])
@pytest.mark.parametrize("stale", [b"of another version", CONTENT[::-1], CONTENT + b"longer"])
def test_a_stale_part_does_no_harm(
    server: Server, tmp_path: Path, stale: bytes, ranges: bool
) -> None:
    server.ranges = ranges
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "network.onnx.part").write_bytes(stale)
    model = tiny(server.address)
    store_of(tmp_path, model).pull(model)
    assert only_file(tmp_path).read_bytes() == CONTENT


def test_a_server_with_a_shorter_file_than_the_part(server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "network.onnx.part").write_bytes(CONTENT[:2000])
    server.content = CONTENT[:1000]
    model = tiny(server.address)
    with pytest.raises(DownloadError, match="1000 bytes instead of 512000"):
        store_of(tmp_path, model).pull(model)


def test_a_wrong_hash_leaves_nothing(server: Server, tmp_path: Path) -> None:
    model = tiny(server.address, sha256="0" * 64)
    store = store_of(tmp_path, model)
    with pytest.raises(DownloadError, match=r"another file than expected \(wrong sha256\)"):
        store.pull(model)
    assert list((tmp_path / "models").iterdir()) == []


def test_a_wrong_hash_leaves_the_old_file_alone(server: Server, tmp_path: Path) -> None:
    model = tiny(server.address, sha256="0" * 64)
    store = store_of(tmp_path, model)
    store.folder.mkdir()
    (store.folder / "network.onnx").write_bytes(b"the user's own")
    with pytest.raises(DownloadError, match="wrong sha256"):
        store.pull(model)
    assert only_file(tmp_path).read_bytes() == b"the user's own"


@pytest.mark.parametrize("content", [b"<html>please log in</html>", CONTENT + b"more"])
def test_a_file_of_another_length_is_refused_at_once(
    server: Server, tmp_path: Path, content: bytes
) -> None:
    server.content = content
    model = tiny(server.address)
    with pytest.raises(DownloadError, match=f"{len(content)} bytes instead of {len(CONTENT)}"):
        store_of(tmp_path, model).pull(model)


def test_an_http_error_is_named(server: Server, tmp_path: Path) -> None:
    server.status = 404
    model = tiny(server.address)
    with pytest.raises(DownloadError, match=r"answers 404 Not Found; try again, or fetch it by"):
        store_of(tmp_path, model).pull(model)


def test_the_next_address_is_tried(
    server: Server, tmp_path: Path, free_port: Callable[[], int]
) -> None:
    nobody = f"http://127.0.0.1:{free_port()}/network.onnx"
    model = tiny(nobody, "ftp://127.0.0.1/network.onnx", server.address)
    store_of(tmp_path, model).pull(model)
    assert only_file(tmp_path).read_bytes() == CONTENT


def test_no_network_is_one_line_that_says_what_to_do(
    tmp_path: Path, free_port: Callable[[], int]
) -> None:
    model = tiny(f"http://127.0.0.1:{free_port()}/network.onnx")
    with pytest.raises(DownloadError) as caught:
        store_of(tmp_path, model).pull(model)
    said = str(caught.value)
    assert "cannot reach 127.0.0.1" in said
    assert "is there a network?" in said
    assert f"put it at {tmp_path / 'models' / 'network.onnx'}" in said
    assert "\n" not in said


def test_a_stalled_server_is_given_up(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "_TIMEOUT_S", 0.1)
    server.stalls, server.breaks_after = True, 1000
    model = tiny(server.address)
    with pytest.raises(DownloadError, match="broke off"):
        store_of(tmp_path, model).pull(model)


def test_only_http_is_spoken(tmp_path: Path) -> None:
    model = tiny((tmp_path / "network.onnx").as_uri())
    with pytest.raises(DownloadError, match="no http address"):
        store_of(tmp_path, model).pull(model)


def test_too_little_room_is_told_before_the_transfer(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    model = tiny(server.address)
    with pytest.raises(DownloadError, match=r"no room for 0\.5 MB in .*FOLLOWER_MODELS"):
        store_of(tmp_path, model).pull(model)
    assert server.requests == []


PULL_WITH_LITTLE_ROOM = """
import resource, sys
from pathlib import Path
from follower_vision.models import VisionModel, ModelFile, ModelStore, Purpose, DownloadError
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
address, folder, size, sha256 = sys.argv[1:]
file = ModelFile("network.onnx", int(size), sha256, (address,))
model = VisionModel("tiny", Purpose.TRACKER, "", "", "", (file,))
try:
    ModelStore(Path(folder), [model]).pull(model)
except DownloadError as error:
    print(error)
"""


def test_a_disk_that_fills_up_underway_is_told_and_the_part_kept(
    server: Server, tmp_path: Path
) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    script = [sys.executable, "-c", PULL_WITH_LITTLE_ROOM, server.address, str(tmp_path)]
    done = subprocess.run(
        [*script, str(len(CONTENT)), SHA256], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("no room for 0.5 MB in ")
    assert done.stdout.count("\n") == 1
    assert (tmp_path / "network.onnx.part").stat().st_size == 100_000
    assert not (tmp_path / "network.onnx").exists()


def test_two_pulls_at_once_do_not_mix(server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    model = tiny(server.address)
    with (folder / "network.onnx.part").open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(DownloadError, match="by another process"):
            store_of(tmp_path, model).pull(model)


def test_a_folder_that_cannot_be_made(server: Server, tmp_path: Path) -> None:
    (tmp_path / "models").write_text("a file in the folder's place")
    model = tiny(server.address)
    with pytest.raises(DownloadError, match=r"cannot make .*models: File exists"):
        store_of(tmp_path, model).pull(model)


def test_missing_files_say_how_to_get_them(tmp_path: Path) -> None:
    own = model_of(ModelFile("own.onnx", 1, "0" * 64), name="own")
    store = store_of(tmp_path, tiny("http://127.0.0.1/"), own)
    with pytest.raises(ModelError, match=r"no such network; `follower models pull tiny`"):
        store.paths(store.model("tiny"))
    with pytest.raises(ModelError, match=r"own cannot be fetched: put your own copy there"):
        store.file("own.onnx")
    with pytest.raises(ModelError, match="none of ours"):
        store.file("other.onnx")
    with pytest.raises(DownloadError, match=r"own\.onnx has no address; put your own copy at"):
        store.pull(own)
    with pytest.raises(ModelError, match="no network 'huge'; there are tiny, own"):
        store.model("huge")


def test_the_default_folder_follows_the_environment() -> None:
    assert default_folder({"FOLLOWER_MODELS": "/data/m", "XDG_CACHE_HOME": "/c"}) == Path("/data/m")
    assert default_folder({"XDG_CACHE_HOME": "/c"}) == Path("/c/follower/models")
    home = Path.home() / ".cache" / "follower" / "models"
    assert default_folder({"XDG_CACHE_HOME": "relative"}) == default_folder({}) == home


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes a user whom nobody knows")
def test_a_user_without_a_home_has_no_networks_and_no_traceback() -> None:
    """As in a container that is started under a bare number."""
    code = (
        "import os\n"
        "from follower_vision.models import default_folder\n"
        "os.setuid(54321)\n"
        "print(default_folder({}).exists())"
    )
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert (ran.stdout, ran.stderr) == ("False\n", "")


def test_the_table_is_sound() -> None:
    names = [model.name for model in MODELS]
    files = [file for model in MODELS for file in model.files]
    assert len(set(names)) == len(names)
    assert len({file.name for file in files}) == len(files)
    for file in files:
        assert re.fullmatch(r"[0-9a-f]{64}", file.sha256)
        assert all(address.startswith("https://") for address in file.addresses)


def test_no_agpl_network_is_offered() -> None:
    agpl = [model for model in MODELS if "AGPL" in model.licence]
    assert not any(model.can_be_fetched or model.usual for model in agpl)
    assert {model.purpose for model in MODELS if model.usual} == {
        Purpose.DETECTOR,
        Purpose.TRACKER,
    }


def test_make_detector_knows_names_and_paths(tmp_path: Path) -> None:
    store = ModelStore(tmp_path)
    assert detector_names(store)[:3] == ["follower-detector", "yolox-nano", "fastestdet"]
    with pytest.raises(ModelError, match="follower models pull yolox-nano"):
        make_detector("yolox-nano", store)
    with pytest.raises(
        ModelError, match="nanotrack-v3 is no detector; there are follower-detector"
    ):
        make_detector("nanotrack-v3", store)
    with pytest.raises(ModelError, match=r"mine\.onnx: no such network"):
        make_detector(str(tmp_path / "mine.onnx"), store)


@pytest.mark.parametrize("file", ["re3.onnx", "siamese_head.onnx", "detector.onnx"])
def test_a_path_may_begin_with_somebodys_home(file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No shell puts the home in its place in a file of settings."""
    store = ModelStore(EMBEDDED_FOLDER)

    def make(name: str) -> object:
        is_detector = file == "detector.onnx"
        return make_detector(name, store) if is_detector else make_tracker(name, store.file)

    monkeypatch.setenv("HOME", str(EMBEDDED_FOLDER))
    assert make(f"~/follower-{file}")
    with pytest.raises(ModelError, match=f"~nobody1/{file}: there is no such home; write"):
        make(f"~nobody1/{file}")


def test_a_folder_of_networks_in_a_home_that_is_not_there_is_one_line() -> None:
    with pytest.raises(ModelError, match="~nobody1/nets: there is no such home"):
        default_folder({"FOLLOWER_MODELS": "~nobody1/nets"})


@needs_data("weights")
def test_the_table_describes_the_real_files() -> None:
    store = ModelStore(DATA / "weights")
    present = [model for model in store.models if store.is_present(model)]
    assert len(present) >= 8
    for model in present:
        assert set(store.verify(model).values()) == {FileState.GOOD}
        if model.purpose is Purpose.DETECTOR:
            assert make_detector(model.name, store).class_names[0] == "person"
