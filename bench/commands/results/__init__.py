"""What the commands return: values, of which `bench.cli` makes text and JSON and `bench.web` its answers.

Nothing is imported here but types: who prints a result pays for no other command.
"""
