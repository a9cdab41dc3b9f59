"""What a policy is worth: `success`, `touchdown`."""
