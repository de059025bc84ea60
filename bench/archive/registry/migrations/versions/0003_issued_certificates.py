"""Certificates that were issued, and those that were withdrawn."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "issues",
        sa.Column("run", sa.String(), nullable=False),
        sa.Column("number", sa.String(), nullable=False),
        sa.Column("verdict", sa.String(), nullable=True),
        sa.Column("issued", sa.String(), nullable=True),
        sa.Column("amends", sa.String(), nullable=True),
        sa.Column("reason", sa.String(), nullable=True),
        sa.Column("file_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.id"], name=op.f("fk_issues_run_runs")),
        sa.PrimaryKeyConstraint("run", "number", name=op.f("pk_issues")),
    )
    op.create_table(
        "withdrawals",
        sa.Column("number", sa.String(), nullable=False),
        sa.Column("reason", sa.String(), nullable=False),
        sa.Column("utc", sa.String(), nullable=False),
        sa.Column("archive", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["archive"], ["archives.id"], name=op.f("fk_withdrawals_archive_archives")),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_withdrawals")),
    )
