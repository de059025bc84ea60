"""A desk that answers for a live run."""

from bench.acquisition.run import control


def live(desk, folder):
    return control.serve_desk(desk, [folder], [folder / "journal" / "bench.gtbj"])
