//! Comparisons and regressions over HTTP against the real program.
