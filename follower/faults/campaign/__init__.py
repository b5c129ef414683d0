"""Many random flights with a cheap vehicle: the real control stage and link, no pixels."""
