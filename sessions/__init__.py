"""The application: bench runs, storage, reprocessing, command line, window, report."""

HDF5_SUFFIXES = (".h5", ".hdf5")
"""How sessions and updaters are named."""
