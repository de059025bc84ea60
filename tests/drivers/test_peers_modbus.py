"""modbus-serial, a JavaScript implementation of Modbus, as server and as client of ours.

Runs where node finds modbus-serial (NODE_PATH), or where BENCH_PEERS is set and npm may fetch it; skipped elsewhere.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.errors import LinkError, RefusedError
from drivers.modbus import ModbusLink
from drivers.sim.faults.proxy import Front, ModbusProxy
from tests.drivers.test_faults_modbus import PV, SP, number

SERVER = """
const { ServerTCP } = require("modbus-serial");
const held = { 2782: 0x0000, 2783: 0x41c8, 2820: 0x0000, 2821: 0xc222 };
const look = address => { if (!(address in held)) { const e = new Error("no"); e.modbusErrorCode = 2; throw e; } };
const vector = {
  getHoldingRegister: address => { look(address); return held[address]; },
  setRegister: (address, value) => { look(address); held[address] = value; },
};
const server = new ServerTCP(vector, { host: "127.0.0.1", port: Number(process.argv[1]), unitID: 1 });
server.on("initialized", () => console.log("ready"));
"""
CLIENT = """
const Modbus = require("modbus-serial");
const client = new Modbus();
const [port, how] = [Number(process.argv[1]), process.argv[2]];
(async () => {
  await client[how]("127.0.0.1", { port });
  client.setID(1); client.setTimeout(2000);
  await client.writeRegisters(2782, [0x0000, 0x42aa]);
  console.log((await client.readHoldingRegisters(2782, 2)).data.join(" "));
  try { await client.readHoldingRegisters(9, 1); } catch (error) { console.log(error.modbusCode); }
  client.close(() => process.exit(0));
})();
"""


@pytest.fixture(scope="module")
def modules(tmp_path_factory) -> Path:
    """A folder with modbus-serial in it."""
    if shutil.which("node") is None:
        pytest.skip("needs node")
    for folder in os.environ.get("NODE_PATH", "").split(os.pathsep):
        if folder and (Path(folder) / "modbus-serial").is_dir():
            return Path(folder)
    if "BENCH_PEERS" not in os.environ or shutil.which("npm") is None:
        pytest.skip("needs modbus-serial: set NODE_PATH, or BENCH_PEERS=1 to fetch it")
    folder = tmp_path_factory.mktemp("node")
    command = ["npm", "install", "--no-audit", "--no-fund", "modbus-serial@8"]
    if subprocess.run(command, cwd=folder, capture_output=True, timeout=120, check=False).returncode:
        pytest.skip("npm could not fetch modbus-serial")
    return folder / "node_modules"


@contextmanager
def node(modules: Path, script: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "NODE_PATH": str(modules)}
    command = ["node", "-e", script, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def test_its_server_is_read_and_written_by_our_link(modules: Path):
    port = free_port()
    with node(modules, SERVER, str(port)) as server:
        assert server.stdout.readline() == "ready\n"
        link = ModbusLink(f"tcp://127.0.0.1:{port}")
        assert (link.read(PV), link.read(SP)) == (-40.5, 25.0)
        link.write(SP, 85.0)
        assert link.read(SP) == 85.0
        with pytest.raises(RefusedError) as refused:
            link.read(number("nothing", 9))
        assert refused.value.code == 2
        link.close()


@pytest.mark.parametrize("front", ["tcp", "rtu+tcp"])
def test_its_server_behind_our_proxy_shows_the_faults(modules: Path, front: Front):
    port = free_port()
    with node(modules, SERVER, str(port)) as server:
        assert server.stdout.readline() == "ready\n"
        proxy = ModbusProxy(("127.0.0.1", port), front)
        link = ModbusLink(proxy.url, timeout_s=0.5, attempts=1)
        proxy.inject("garble", times=1)
        with pytest.raises(LinkError):
            link.read(PV)
        assert link.read(PV) == -40.5
        link.close()
        proxy.close()


@pytest.mark.parametrize(("front", "how"), [("tcp", "connectTCP"), ("rtu+tcp", "connectTelnet")])
def test_its_client_understands_what_our_proxy_serves(modules: Path, front: Front, how: str):
    port = free_port()
    with node(modules, SERVER, str(port)) as server:
        assert server.stdout.readline() == "ready\n"
        proxy = ModbusProxy(("127.0.0.1", port), front)
        with node(modules, CLIENT, str(proxy.port), how) as client:
            said = client.stdout.read().split("\n")
        proxy.close()
    assert said[:2] == ["0 17066", "2"]
