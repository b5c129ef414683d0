"""Many starts a sequence, folds that are fixed, and the history of what was scored."""
