"""A page that is served, and what it answers."""

import http.client
import threading
from contextlib import contextmanager

from bms_gateway.workbench.server import Server
from bms_gateway.workbench.site import Site


@contextmanager
def serving(site=None, host="127.0.0.1", **options):
    server = Server(site or Site(), host, 0, **options)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield server
    finally:
        server.site.close()
        server.shutdown()
        thread.join()
        server.server_close()


def ask(server, method, path, body=None, **headers):
    port = server.server_address[1]
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.request(method, path, body, {"Host": f"127.0.0.1:{port}"} | headers)
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())
    finally:
        connection.close()
