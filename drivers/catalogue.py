"""`python -m drivers.catalogue > docs/chambers.md` writes the documentation of all shipped register maps."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from drivers.registers import Register, RegisterMap, list_maps, load_map

_HEAD = """\
# Chambers

Written by `python -m drivers.catalogue` from the register maps in `drivers/chambers/`; do not edit. Addresses are
0-based, as sent on the wire. No map was tested on a real controller yet: run `bench doctor STATION` on yours first, and
compare the registers marked as uncertain with its panel. This command only reads.

Another controller needs a new map and no code: a YAML file beside the station file, named there as
`map: mine.yaml`. `bench doctor STATION --contract` tests it on a simulated controller.
"""


def markdown() -> str:
    """docs/chambers.md: a table of all shipped maps, then a chapter for each."""
    maps = {name: load_map(name) for name in list_maps()}
    lines = [_HEAD, "| map | controller | connection | ramp |", "|---|---|---|---|"]
    lines += [f"| [{n}](#{n}) | {m.model} | {m.connection} | {_ramp(m)} |" for n, m in maps.items()]
    for name, registers in maps.items():
        lines += ["", *_chapter(name, registers)]
    return "\n".join(lines) + "\n"


def _chapter(name: str, registers: RegisterMap) -> Iterator[str]:
    yield f"## {name}"
    yield ""
    yield f"{registers.model}. {registers.connection}. Ramp: {_ramp(registers)}."
    yield ""
    for rule in registers.identify:
        yield f"- Refused unless `{rule.register}` matches: {rule.why}."
    if registers.eeprom_writes:
        yield f"- Memory endures {registers.eeprom_writes} writes: written on change only, never stepped by the host."
    run = registers.run
    if run.least_on_s or run.least_off_s:
        yield f"- At least {run.least_on_s:g} s on and {run.least_off_s:g} s off; the safe state does not wait."
    for note in registers.notes:
        yield f"- {note}"
    yield ""
    yield "| register | address | type | access | meaning | source |"
    yield "|---|---|---|---|---|---|"
    for register in registers.registers.values():
        yield _row(register)
    yield ""
    for code, source in registers.sources.items():
        yield f"- {code}: {source}"


def _row(register: Register) -> str:
    order = f", {register.word_order.replace('_', ' word ')}" if register.word_order and register.count == 2 else ""
    mask = "" if register.mask is None else f", bits {register.mask:#06x}"
    decimals = f", decimals in `{register.decimals}`" if register.decimals else ""
    access = f"read {register.read}" + (f", write {register.write}" if register.write else "")
    unit = f" [{register.unit}]" if register.unit else ""
    values = "; " + ", ".join(f"{code} {name}" for name, code in register.values.items()) if register.values else ""
    doubt = " **uncertain**" if register.uncertain else ""
    kind = f"{register.type}{order}{mask}{decimals}"
    return (
        f"| `{register.name}` | {register.address} (0x{register.address:04X}) | {kind} | {access} "
        f"| {register.meaning}{unit}{values} | {register.source}{doubt} |"
    )


def _ramp(registers: RegisterMap) -> str:
    return "native" if registers.native_ramp else "stepped by the bench"


if __name__ == "__main__":
    sys.stdout.write(markdown())
