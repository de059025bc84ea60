"""Alembic's entry: migrates the connection that `bench.archive.registry.opening` hands over, in its transaction."""

from alembic import context

from bench.archive.registry.tables import Table

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Table.metadata,
    render_as_batch=True,
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
