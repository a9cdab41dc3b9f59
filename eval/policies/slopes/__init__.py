"""What a policy that observes the slope is worth on every one: `command` < `figures` < `study`."""
