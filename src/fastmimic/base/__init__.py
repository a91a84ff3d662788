"""What everything stands on: conventions, rotations, small vectors, errors, files, compilation."""
