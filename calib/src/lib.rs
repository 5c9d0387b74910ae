//! Reads and writes camera calibrations.
