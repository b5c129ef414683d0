"""The appearance of a target: blur, colour, templates, re-identification.

Uses: `geometry`, `images`.
Start at: `reidentify.Reidentifier`, which scores as the Fusion paper does.
"""
