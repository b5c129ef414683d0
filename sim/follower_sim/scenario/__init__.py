"""Scenarios as data: the YAML schema and its loading.

Uses: `bodies`, `paths`, `vehicle` settings.
Start at: `scenario.Scenario`.
"""
