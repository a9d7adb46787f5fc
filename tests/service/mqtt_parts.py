"""A publisher without a broker, its run beside other coroutines, and certificates of a broker."""

import asyncio
import subprocess

from bms_gateway.config.schema import Mqtt
from bms_gateway.service.mqtt import Publisher


def publisher(files=None, estimates=dict, **settings):
    lines = ["OK"]
    wanted = {"host": "broker", "topic": "cars/7", "spool": 10, "interval_s": 3600.0} | settings
    made = Publisher(Mqtt(**wanted), files or {}, status=lambda: lines[-1], estimates=estimates)
    made.lines = lines
    return made


def running(p, *parts):
    """Run the publisher beside coroutine functions, then stop it; gives the exception with which it ended."""

    async def both():
        task = asyncio.ensure_future(p.run())
        for part in parts:
            await part()
        task.cancel()
        (result,) = await asyncio.gather(task, return_exceptions=True)
        return result

    return asyncio.run(both())


def certificates(folder, name="localhost"):
    """An authority and a broker's certificate."""
    ca, key, request, cert = (folder / f"{name}.{end}" for end in ("ca", "key", "csr", "crt"))
    ca_key = folder / f"{name}.ca.key"
    new = ["-newkey", "rsa:2048", "-nodes"]
    for words in (
        ["req", "-x509", *new, "-keyout", ca_key, "-out", ca, "-subj", f"/CN=authority {name}", "-days", "2"],
        ["req", *new, "-keyout", key, "-out", request, "-subj", f"/CN={name}"],
        ["x509", "-req", "-in", request, "-CA", ca, "-CAkey", ca_key, "-CAcreateserial", "-out", cert, "-days", "2"],
    ):
        more = []
        if words[0] == "x509":
            (folder / "ext").write_text(f"subjectAltName=DNS:{name}")
            more = ["-extfile", folder / "ext"]
        subprocess.run(["openssl", *words, *more], check=True, capture_output=True)
    return ca, key, cert
