"""A table of somebody else becomes a run folder: tables, columns, units, branches, and the plan of it all."""

from bench.acquisition.importer.columns import ColumnMap
from bench.acquisition.importer.plan import ImportPlan, load_columns, plan_import, plan_table, write_import

__all__ = ["ColumnMap", "ImportPlan", "load_columns", "plan_import", "plan_table", "write_import"]
