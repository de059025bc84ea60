"""First tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "archives",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("path", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_archives")),
    )
    op.create_table(
        "equipment",
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("serial", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("calibrated_on", sa.Date(), nullable=True),
        sa.Column("due_on", sa.Date(), nullable=True),
        sa.Column("archive", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["archive"], ["archives.id"], name=op.f("fk_equipment_archive_archives")),
        sa.PrimaryKeyConstraint("name", "serial", name=op.f("pk_equipment")),
    )
    op.create_table(
        "operators",
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("archive", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["archive"], ["archives.id"], name=op.f("fk_operators_archive_archives")),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_operators")),
    )
    op.create_table(
        "units",
        sa.Column("serial", sa.String(), nullable=False),
        sa.Column("lot", sa.String(), nullable=True),
        sa.Column("archive", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["archive"], ["archives.id"], name=op.f("fk_units_archive_archives")),
        sa.PrimaryKeyConstraint("serial", name=op.f("pk_units")),
    )
    op.create_table(
        "runs",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("archive", sa.String(length=32), nullable=False),
        sa.Column("path", sa.String(), nullable=False),
        sa.Column("unit", sa.String(), nullable=False),
        sa.Column("profile", sa.String(), nullable=True),
        sa.Column("profile_sha256", sa.String(length=64), nullable=True),
        sa.Column("station", sa.String(), nullable=True),
        sa.Column("operator", sa.String(), nullable=True),
        sa.Column("created", sa.String(), nullable=True),
        sa.Column("state", sa.String(), nullable=True),
        sa.Column("cause", sa.String(), nullable=True),
        sa.Column("simulated", sa.Boolean(), nullable=True),
        sa.Column("samples", sa.BigInteger(), nullable=True),
        sa.Column("lost", sa.BigInteger(), nullable=True),
        sa.Column("duration_s", sa.Double(), nullable=True),
        sa.Column("software", sa.String(), nullable=True),
        sa.Column("manifest_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["archive"], ["archives.id"], name=op.f("fk_runs_archive_archives")),
        sa.ForeignKeyConstraint(["operator"], ["operators.name"], name=op.f("fk_runs_operator_operators")),
        sa.ForeignKeyConstraint(["unit"], ["units.serial"], name=op.f("fk_runs_unit_units")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_runs")),
    )
    with op.batch_alter_table("runs", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_runs_archive"), ["archive"], unique=False)
        batch_op.create_index(batch_op.f("ix_runs_created"), ["created"], unique=False)
        batch_op.create_index(batch_op.f("ix_runs_unit"), ["unit"], unique=False)

    op.create_table(
        "calibrations",
        sa.Column("run", sa.String(), nullable=False),
        sa.Column("verdict", sa.String(), nullable=True),
        sa.Column("judged", sa.String(), nullable=True),
        sa.Column("limits", sa.String(), nullable=True),
        sa.Column("model", sa.String(), nullable=True),
        sa.Column("coefficients_sha256", sa.String(length=64), nullable=True),
        sa.Column("validity", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("file_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.id"], name=op.f("fk_calibrations_run_runs")),
        sa.PrimaryKeyConstraint("run", name=op.f("pk_calibrations")),
    )
    with op.batch_alter_table("calibrations", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_calibrations_coefficients_sha256"), ["coefficients_sha256"], unique=False)

    op.create_table(
        "certificates",
        sa.Column("run", sa.String(), nullable=False),
        sa.Column("number", sa.String(), nullable=True),
        sa.Column("verdict", sa.String(), nullable=True),
        sa.Column("issued", sa.String(), nullable=True),
        sa.Column("operator", sa.String(), nullable=True),
        sa.Column("file_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.id"], name=op.f("fk_certificates_run_runs")),
        sa.PrimaryKeyConstraint("run", name=op.f("pk_certificates")),
    )
    op.create_table(
        "quantities",
        sa.Column("run", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("unit", sa.String(), nullable=True),
        sa.Column("value", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.id"], name=op.f("fk_quantities_run_runs")),
        sa.PrimaryKeyConstraint("run", "name", name=op.f("pk_quantities")),
    )
