//! Identities of replicas, and of uploads and claims that end with them.

use crate::domain::id;

/// Separator between the id of a replica and that of its objects.
pub(super) const SEPARATOR: char = '.';

/// Identifier of a replica or an upload.
fn new_id() -> String {
    id::unique()
}

/// Identifier of this replica for its lifetime.
#[derive(Debug)]
pub(super) struct Replica(pub(super) String);

impl Replica {
    pub(super) fn new() -> Self {
        Self(new_id())
    }

    /// Identifier of something that ends with this process: an upload or a claim.
    pub(super) fn owned_id(&self) -> String {
        format!("{}{SEPARATOR}{}", self.0, new_id())
    }
}
