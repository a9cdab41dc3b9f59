"""Tasks, the batched environment, its Gymnasium and Stable-Baselines3 faces, rendering."""
