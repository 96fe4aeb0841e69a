//! Words of `Cache-Control`.

/// `Cache-Control` of answers that must not be stored.
pub(super) const NO_STORE: &str = "no-store";

/// `Cache-Control` of answers that never change at their address. Private, because they belong to the holder of a key; for a day, because a
/// version may be deleted, and a new release of the program may draw it differently.
pub(super) const IMMUTABLE: &str = "private, max-age=86400, immutable";
