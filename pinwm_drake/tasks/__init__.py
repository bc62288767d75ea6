"""Tasks: goals, progress, rewards and states that tell one task from another; no Drake."""
