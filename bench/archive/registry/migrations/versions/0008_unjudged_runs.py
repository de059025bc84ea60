"""A unit stands by its newest judged run; a newer one that was not judged is told beside."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables; whoever brings a registry up to date makes its summaries anew."""
    op.add_column("summaries", sa.Column("unjudged", sa.String(), nullable=True))
