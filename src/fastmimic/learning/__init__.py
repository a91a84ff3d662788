"""The learned baseline: a policy's observation and action, its file, its training, and the environments."""
