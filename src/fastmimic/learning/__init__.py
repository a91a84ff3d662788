"""The learned baseline: observation, action, policy file, training and Gymnasium environments."""
