"""Runs of units that corrected themselves."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables."""
    op.add_column("runs", sa.Column("corrected", sa.Boolean(), nullable=True))
