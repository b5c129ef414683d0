"""`follower preflight`: a table of checks, each a small function of one snapshot.

Uses: `links`, `apps.video_input`.
Start at: `checklist`.
"""
