"""The page, put together, and a server that speaks the protocol of docs/viewer.md. What it sends, the tests say."""

import json
import queue
import re
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

PARTS = Path(__file__).parents[2] / "src/report/viewer"


def page(vessel=None):
    """The page of a vessel, or of one that is still to come."""
    html = (PARTS / "viewer.html").read_text()
    for mark in set(re.findall(r"/\*([a-z]+\.(?:js|css))\*/", html)):
        assert html.count(f"/*{mark}*/") == 1, mark
        html = html.replace(f"/*{mark}*/", (PARTS / mark).read_text())
    data = "" if vessel is None else json.dumps(vessel).replace("<", "\\u003c")
    assert html.count("/*vessel*/") == 1
    return html.replace("/*vessel*/", data)


class Server:
    """Sends the first event of every connection from `first`, and then what `send` is given."""

    def __init__(self, port):
        self.url = f"http://127.0.0.1:{port}/"
        self.first, self.queues, self.connections = [], [], 0

    def send(self, event):
        for one in list(self.queues):
            one.put(event)

    def interrupt(self):
        """Closes all connections, as a network does."""
        self.send(None)


@contextmanager
def serving(first=()):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            if self.path == "/":
                body = page().encode()
                self.answer("text/html; charset=utf-8", len(body))
                self.wfile.write(body)
            elif self.path == "/events":
                self.events()
            else:
                self.send_error(404)

        def answer(self, kind, length=None):
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", "no-store")
            if length is not None:
                self.send_header("Content-Length", str(length))
            self.end_headers()

        def events(self):
            waiting = queue.Queue()
            self.answer("text/event-stream")
            self.wfile.write(b"retry: 100\n\n")
            for event in server.first:
                self.event(event)
            server.queues.append(waiting)
            server.connections += 1
            while (event := waiting.get()) is not None:
                self.event(event)
            server.queues.remove(waiting)
            self.close_connection = True

        def event(self, event):
            try:
                self.wfile.write(f"data: {json.dumps(event)}\n\n".encode())
            except OSError:
                pass

        def log_message(self, *_):
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    http.daemon_threads = True
    server = Server(http.server_port)
    server.first = list(first)
    threading.Thread(target=http.serve_forever, daemon=True).start()
    try:
        yield server
    finally:
        server.interrupt()
        http.shutdown()
        http.server_close()
