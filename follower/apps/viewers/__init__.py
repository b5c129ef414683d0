"""A recorded flight as files for viewers of others: `follower inspect --foxglove`, `--rerun`.

Uses: `follower.recording`, `follower_control`; the packages of the extras `foxglove` and `rerun`.
Start at: `foxglove_file.write_foxglove`, `rerun_file.write_rerun`.
"""
