"""Laboratory and equipment of a certificate: given, kept in the run folder, or named by the station file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench import acquisition, deliver
from bench.base import Document, InputError, library, nearest_or_all, read_yaml
from bench.record import slug
from drivers.registers import is_map_file

LABORATORY, EQUIPMENT = "laboratory.yaml", "equipment.yaml"
"""As a run folder keeps them."""
PAPERS = ("laboratory", "equipment")
OWN = Path("profiles")
"""The user's own files (`bench init`), in the folder in which the bench is started."""


@dataclass(frozen=True)
class Papers:
    """Both files as they were read; None where there is none."""

    laboratory: Document | None = None
    equipment: Document | None = None

    @classmethod
    def of_files(cls, laboratory: Path | None, equipment: Path | None) -> Papers:
        """Read from files; InputError where one cannot be read."""
        read = [None if path is None else read_yaml(path) for path in (laboratory, equipment)]
        return cls(*read)

    @classmethod
    def of_run(cls, folder: Path) -> Papers:
        """The copies that a run folder keeps."""
        kept = [path if (path := folder / name).is_file() else None for name in (LABORATORY, EQUIPMENT)]
        return cls.of_files(*kept)

    @classmethod
    def of_station(cls, station: acquisition.StationSettings, own: Path = OWN) -> Papers:
        """Those that a station names; InputError where one does not exist or is wrong. `own`: the user's own files."""
        found = cls.of_files(*(_named(kind, station, own) for kind in PAPERS))
        if found.laboratory is not None:
            deliver.load_laboratory(found.laboratory)
        if found.equipment is not None:
            deliver.load_instruments(found.equipment)
        return found

    def over(self, other: Papers) -> Papers:
        """These, and those of `other` where there are none."""
        return Papers(self.laboratory or other.laboratory, self.equipment or other.equipment)

    def texts(self) -> dict[str, str]:
        """The files of a run folder."""
        known = {LABORATORY: self.laboratory, EQUIPMENT: self.equipment}
        return {name: document.text for name, document in known.items() if document is not None}


def own_paper(kind: str, station: acquisition.StationSettings, own: Path = OWN) -> Path:
    """The user's own file of a station, whether it exists or not: the one that the station names, or by its name."""
    given = getattr(station, kind)
    if given is not None and is_map_file(given):
        return Path(given)
    return own / kind / f"{given or _for(station)}.yaml"


def told_by(station: acquisition.StationSettings, own: Path = OWN) -> acquisition.StationSettings:
    """The station with the recipients that are filled in for it, where its file names none."""
    filled = own_paper("notify", station, own)
    if station.notify is not None or not filled.is_file():
        return station
    return station.model_copy(update={"notify": str(filled.absolute())})


def _for(station: acquisition.StationSettings) -> str:
    """Name of the file of a station that names none; none that is shipped has it."""
    return f"station_{slug(station.name)}"


def _named(kind: str, station: acquisition.StationSettings, home: Path) -> Path | None:
    """The user's own file of a station, or a shipped one of that name; None where it names none and there is none."""
    own, given = own_paper(kind, station, home), getattr(station, kind)
    if own.is_file():
        return own
    if given is not None and is_map_file(given):
        raise InputError(f"{kind}: {own}: no such file", *station.place(kind))
    if given is None:
        return None
    folders = (home / kind, library() / kind)
    for folder in folders:
        if (folder / f"{given}.yaml").is_file():
            return folder / f"{given}.yaml"
    known = sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})
    said = f"no {kind} file is called '{given}'{nearest_or_all(given, known)}"
    raise InputError(f"{said}; the name of a file beside the station file ends in .yaml", *station.place(kind))
