"""`follower fly` and what it shares with `follower preflight`: a real vehicle, a real camera."""
