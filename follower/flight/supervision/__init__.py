"""Who may move the vehicle: supervisor, consent, sticks, release, autonomy.

Uses: `settings`, `links`.
Start at: `supervisor.next_state` and its table.
"""
