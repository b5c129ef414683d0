"""Ground, sky, scenery and bodies, and the renderer that draws them.

Uses: `bodies`, `paths`, `scenario`, `view`.
Start at: `world.World`, `render.Renderer`.
"""
