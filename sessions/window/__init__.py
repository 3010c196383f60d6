"""The live window: shows snapshots of what recorder and estimator hold, and computes nothing."""
