//! The laws of the analysis on random input.
