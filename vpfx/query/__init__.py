"""Questions to a store: who is beside whom on a level, and whose parent or child between levels."""
