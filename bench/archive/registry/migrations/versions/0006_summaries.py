"""The list of units, kept; runs by station, units by lot."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables; `bench.archive.registry.summaries` fills the new one."""
    texts = ("lot", "last", "last_run", "state", "station", "calibrated", "model", "judged", "certificate")
    op.create_table(
        "summaries",
        sa.Column("serial", sa.String(), nullable=False),
        sa.Column("words", sa.String(), nullable=False),
        sa.Column("standing", sa.String(), nullable=False),
        sa.Column("runs", sa.Integer(), nullable=False),
        sa.Column("calibrations", sa.Integer(), nullable=False),
        *(sa.Column(name, sa.String(), nullable=True) for name in texts),
        sa.PrimaryKeyConstraint("serial", name=op.f("pk_summaries")),
    )
    op.create_index("ix_summaries_last", "summaries", ["last", "serial", "standing", "words"])
    op.create_index("ix_summaries_standing", "summaries", ["standing", "serial", "words"])
    op.create_index(op.f("ix_runs_station"), "runs", ["station"])
    op.create_index(op.f("ix_units_lot"), "units", ["lot"])
