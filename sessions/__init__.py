"""The application: bench runs, storage, reprocessing, command line, window, report."""
