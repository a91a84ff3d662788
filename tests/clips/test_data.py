"""Fetching public data from a server on this machine: all that arrives is verified, or nothing changes."""

import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from fastmimic.base.errors import DataError
from fastmimic.base.registry import Registry
from fastmimic.clips import data

FIRST = b"first file\n" * 500
SECOND = b"second file\n" * 300
Reply = Callable[[BaseHTTPRequestHandler], None]


def whole(content: bytes) -> Reply:
    def reply(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Length", str(len(content)))
        request.end_headers()
        request.wfile.write(content)

    return reply


def truncated(content: bytes) -> Reply:
    """Announces everything, sends half, and hangs up."""

    def reply(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Length", str(len(content)))
        request.end_headers()
        request.wfile.write(content[: len(content) // 2])

    return reply


def failing(status: int) -> Reply:
    return lambda request: request.send_error(status)


class Server:
    """Replies by path; 404 for the others. Notes what was asked for."""

    def __init__(self) -> None:
        self.replies: dict[str, Reply] = {}
        self.asked: list[str] = []
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                server.asked.append(self.path)
                server.replies.get(self.path, failing(404))(self)

            def log_message(self, format: str, *args: object) -> None: ...

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    server = Server()
    server.replies = {"/there/a.txt": whole(FIRST), "/there/b.txt": whole(SECOND)}
    thread = threading.Thread(target=server.http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield server
    server.http.shutdown()
    server.http.server_close()
    thread.join()


@pytest.fixture(autouse=True)
def small_dataset(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """One made-up dataset of two files in place of the public ones, and no settings from outside."""
    if "real_datasets" in request.fixturenames:
        return
    files = {"a.txt": sha256(FIRST).hexdigest(), "b.txt": sha256(SECOND).hexdigest()}
    made_up = [data.Dataset("here", "made up", "there", files, "CC BY-NC 4.0", "nobody")]
    monkeypatch.setattr(data, "DATASETS", Registry("dataset", made_up, error=DataError))
    monkeypatch.delenv(data.FOLDER_VARIABLE, raising=False)
    monkeypatch.delenv(data.URL_VARIABLE, raising=False)


@pytest.fixture
def real_datasets() -> None:
    """Keeps the public datasets for a test that asks for this."""


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_fetch_brings_all_files_to_their_folder(server: Server, tmp_path: Path):
    paths = data.fetch(folder=tmp_path, base_url=server.url)
    assert paths == [tmp_path / "here" / "a.txt", tmp_path / "here" / "b.txt"]
    assert files_in(tmp_path) == {"here/a.txt": FIRST, "here/b.txt": SECOND}


def test_folder_and_server_can_be_set_by_the_environment(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv(data.URL_VARIABLE, server.url + "/")
    data.fetch()
    assert set(files_in(tmp_path)) == {"here/a.txt", "here/b.txt"}


def test_what_is_there_is_not_fetched_again(server: Server, tmp_path: Path):
    data.fetch(folder=tmp_path, base_url=server.url)
    server.asked.clear()
    data.fetch(folder=tmp_path, base_url=server.url)
    assert server.asked == []


def test_a_damaged_file_is_replaced(server: Server, tmp_path: Path):
    data.fetch(folder=tmp_path, base_url=server.url)
    (tmp_path / "here" / "a.txt").write_bytes(b"damaged")
    data.fetch(folder=tmp_path, base_url=server.url)
    assert files_in(tmp_path) == {"here/a.txt": FIRST, "here/b.txt": SECOND}


@pytest.mark.parametrize(
    ("reply", "problem"),
    [
        (truncated(SECOND), "broke off"),
        (whole(b"something else"), "SHA-256 differs"),
        (whole(b""), "SHA-256 differs"),
        (failing(404), "no such file"),
        (failing(503), "answered 503"),
    ],
)
def test_a_failed_download_leaves_everything_as_it_was(server: Server, tmp_path: Path, reply: Reply, problem: str):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "b.txt").write_bytes(b"an older one")
    (tmp_path / "mine.txt").write_bytes(b"not ours")
    server.replies["/there/b.txt"] = reply
    with pytest.raises(DataError, match=problem) as caught:
        data.fetch(folder=tmp_path, base_url=server.url)
    assert "/there/b.txt" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert files_in(tmp_path) == {"here/a.txt": FIRST, "here/b.txt": b"an older one", "mine.txt": b"not ours"}


def test_an_unreachable_server(tmp_path: Path, server: Server):
    server.http.server_close()
    with pytest.raises(DataError, match="cannot be reached"):
        data.fetch(folder=tmp_path, base_url=server.url)
    assert files_in(tmp_path) == {}


@pytest.mark.parametrize("url", ["nonsense", "ftp://127.0.0.1/data", "http://"])
def test_a_base_url_that_is_none(tmp_path: Path, url: str):
    with pytest.raises(DataError, match="cannot be fetched"):
        data.fetch(folder=tmp_path, base_url=url)


def test_a_folder_that_cannot_be_written(server: Server, tmp_path: Path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match="cannot be written"):
        data.fetch(folder=tmp_path / "file", base_url=server.url)


def test_interrupting_leaves_nothing_half_written(server: Server, tmp_path: Path):
    def interrupt(name: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        data.fetch(folder=tmp_path, base_url=server.url, progress=interrupt)
    assert files_in(tmp_path) == {}


def test_progress_grows_to_the_whole_file(server: Server, tmp_path: Path):
    calls: list[tuple[str, int, int]] = []
    data.fetch(folder=tmp_path, base_url=server.url, progress=lambda *call: calls.append(call))
    done = [d for name, d, _ in calls if name == "here/a.txt"]
    assert done == sorted(done)
    assert done[-1] == len(FIRST)
    assert {total for name, _, total in calls if name == "here/a.txt"} == {len(FIRST)}


def test_unknown_dataset_offers_the_closest(tmp_path: Path):
    with pytest.raises(DataError, match=r"unknown dataset 'hre'; there are here; did you mean 'here'\?"):
        data.fetch(["hre"], folder=tmp_path)


def test_list_says_what_is_there(server: Server, tmp_path: Path):
    ((_, present),) = data.list_datasets(tmp_path)
    assert present == []
    data.fetch(folder=tmp_path, base_url=server.url)
    ((dataset, present),) = data.list_datasets(tmp_path)
    assert present == ["a.txt", "b.txt"] == list(dataset.files)
    assert (dataset.licence, dataset.credit) == ("CC BY-NC 4.0", "nobody")


def test_the_recordings_have_licence_and_credit(real_datasets: None):
    assert len(data.DATASETS) == 2
    for dataset in data.DATASETS.values():
        assert "CC BY-NC 4.0" in dataset.licence
        assert "AI4Animation" in dataset.credit


def test_a_copy_is_recognised_by_its_content(tmp_path: Path):
    (tmp_path / "copy").write_bytes(FIRST)
    (tmp_path / "other").write_bytes(FIRST + b"\n")
    found = data.dataset_of(tmp_path / "copy")
    assert found is not None
    assert found.name == "here"
    assert data.dataset_of(tmp_path / "other") is None
    assert data.dataset_of(tmp_path / "nowhere") is None


def test_the_folder_without_settings_is_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert data.data_folder().name == "fastmimic"


@pytest.mark.usefixtures("real_datasets")
def test_real_files_have_the_hashes_of_the_registry(data_folder: Path):
    """Nothing is asked of the server, so a read-only folder without a network will do."""
    paths = data.fetch(folder=data_folder, base_url="http://127.0.0.1:9")
    assert len(paths) == 14
    assert all(present == list(dataset.files) for dataset, present in data.list_datasets(data_folder))
