//! Words of `Cache-Control`.

/// `Cache-Control` of what must not be stored.
pub(super) const NO_STORE: &str = "no-store";

/// `Cache-Control` of what never changes at its address. Private, because it belongs to who holds a key; for a day, because a
/// version may be deleted, and a new release of the program may draw it differently.
pub(super) const IMMUTABLE: &str = "private, max-age=86400, immutable";
