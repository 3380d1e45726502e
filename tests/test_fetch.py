"""Downloads from a local server: whole, resumed, broken off, too long, wrong, missing; paths that lead astray."""

import hashlib
import lzma
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tomthumb.errors import TomThumbError, UnknownName
from tomthumb.fetch import RemoteFile, Source, fetch, fetch_source, is_right, parse_source, sources

DATA = bytes(range(256)) * 4000


class Handler(BaseHTTPRequestHandler):
    """Serves DATA in the manner that the path names, and remembers what it was asked."""

    def __init__(self, asked, *args):
        self.asked = asked
        super().__init__(*args)

    def do_GET(self):
        way = self.path.rsplit("/", 1)[-1]
        start = self.headers.get("Range")
        self.asked.append((way, start))
        if way == "missing":
            self.send_error(404)
            return
        at = int(start[6:-1]) if start and way != "deaf" else 0
        body = {"long": DATA + b"more" * 10_000, "wrong": DATA[::-1]}.get(way, DATA)[at:]
        self.send_response(206 if at else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[:300_000] if way == "broken" and not at else body)

    def log_message(self, *args):
        pass


@pytest.fixture
def server():
    asked = []
    httpd = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, asked))
    thread = threading.Thread(target=httpd.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{httpd.server_port}", asked
    httpd.shutdown()
    httpd.server_close()
    thread.join()


def source(url, *ways):
    digest = hashlib.sha256(DATA).hexdigest()
    files = tuple(RemoteFile(way, f"{way}.dat", len(DATA), digest) for way in ways)
    return Source("test", "csv", url, "none", "nobody", "all", files)


def test_files_are_fetched_once(server, tmp_path):
    url, asked = server
    seen = []
    first = fetch_source(source(url, "whole"), tmp_path, progress=lambda *a: seen.append(a))
    assert first["downloaded"] == ["whole.dat"]
    assert first["licence"] == "none"
    assert (tmp_path / "whole.dat").read_bytes() == DATA
    assert seen[-1] == ("whole.dat", len(DATA), len(DATA))
    assert fetch_source(source(url, "whole"), tmp_path)["kept"] == ["whole.dat"]
    assert len(asked) == 1


@pytest.mark.parametrize("way", ["broken", "deaf"])
def test_a_broken_download_is_taken_up_again(server, tmp_path, way):
    url, asked = server
    if way == "broken":
        with pytest.raises(TomThumbError, match="try again"):
            fetch_source(source(url, way), tmp_path)
    else:
        (tmp_path / "deaf.dat.part").write_bytes(DATA[:1000])
    assert not (tmp_path / f"{way}.dat").exists()
    have = (tmp_path / f"{way}.dat.part").stat().st_size
    assert have > 0
    fetch_source(source(url, way), tmp_path)
    assert asked[-1] == (way, f"bytes={have}-")
    assert (tmp_path / f"{way}.dat").read_bytes() == DATA


@pytest.mark.parametrize("way", ["wrong", "long"])
def test_a_wrong_file_is_removed(server, tmp_path, way):
    url, _ = server
    with pytest.raises(TomThumbError, match="not the file that was expected"):
        fetch_source(source(url, way), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_spoiled_on_disk_is_fetched_again(server, tmp_path):
    url, _ = server
    (tmp_path / "whole.dat").write_bytes(DATA[::-1])
    assert fetch_source(source(url, "whole"), tmp_path)["downloaded"] == ["whole.dat"]
    assert is_right(tmp_path / "whole.dat", source(url, "whole").files[0])


def test_missing_files_and_servers_are_named(server, tmp_path):
    url, _ = server
    with pytest.raises(TomThumbError, match="HTTP 404"):
        fetch_source(source(url, "missing"), tmp_path)
    with pytest.raises(TomThumbError, match=r"127\.0\.0\.1:1/"):
        fetch_source(source("http://127.0.0.1:1", "whole"), tmp_path)
    with pytest.raises(UnknownName, match="did you mean 'car_park'"):
        fetch("car_pork", tmp_path)


@pytest.mark.parametrize("local", ["../a", "/a", "a/../../b", "a\\b", ""])
def test_paths_stay_in_the_folder(local):
    raw = {"kind": "csv", "url": "", "licence": "", "citation": "", "seen": ""}
    with pytest.raises(TomThumbError, match="out of the folder"):
        parse_source("x", raw | {"files": [{"remote": "a", "local": local, "bytes": 1, "sha256": "0" * 64}]})
    with pytest.raises(TomThumbError, match="KeyError"):
        parse_source("x", raw)


def test_the_list_of_sources_is_whole():
    from tomthumb.scenarios import entries

    assert len(sources()) >= 9
    for source in sources().values():
        assert source.kind in entries()
        assert source.files
        assert source.citation
        assert source.seen


@pytest.mark.data
@pytest.mark.parametrize(("name", "folder"), [("car_park", "car_park"), ("freiburg", "freiburg_slam_course")])
def test_the_logs_here_are_those_of_the_list(data_dir, name, folder):
    for file in sources()[name].files:
        assert is_right(data_dir / folder / file.local, file)


@pytest.mark.data
def test_the_fetched_mrclam_set_is_ours_without_trailing_blanks(data_dir):
    for file in sources()["mrclam7"].files:
        path = data_dir / "utias_mrclam" / "MRCLAM_Dataset7" / file.local
        data = path.read_bytes() if path.exists() else lzma.decompress(path.with_name(file.local + ".xz").read_bytes())
        plain = b"\n".join(line.rstrip(b" ") for line in data.split(b"\n"))
        assert (len(plain), hashlib.sha256(plain).hexdigest()) == (file.bytes, file.sha256)
