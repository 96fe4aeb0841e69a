//! Keys, and access to the store beside its service.

use super::*;
use crate::domain::access::Role;
use crate::domain::key::{Key, Secret};

fn key(tenant: &str) -> Key {
    let id = id::new_id(id::KEY);
    let digest = Secret::new(&id, [3; 32]).digest();
    Key {
        id,
        tenant: tenant.into(),
        name: "a pipeline".into(),
        role: Role::Writer,
        cohorts: Some(vec!["coh_1".into(), "coh_2".into()]),
        digest,
        created_at_ms: 5,
        expires_at_ms: Some(6),
        revoked_at_ms: None,
        used_at_ms: None,
    }
}

#[tokio::test]
async fn keys_come_back_as_they_were_stored() {
    let (_folder, store) = fresh().await;
    assert!(!store.has_keys().await.unwrap());
    let limited = key("a");
    let open = Key { cohorts: None, expires_at_ms: None, ..key("b") };
    for key in [&limited, &open] {
        store.create_key(key).await.unwrap();
        assert_eq!(store.find_key(&key.id).await.unwrap().as_ref(), Some(key));
    }
    assert!(store.has_keys().await.unwrap());
    assert_eq!(store.find_key("key_0").await.unwrap(), None);
    assert_eq!(store.list_keys(Some("a"), None, 10).await.unwrap(), std::slice::from_ref(&limited));
    assert_eq!(store.list_keys(Some("b"), Some(&open.id), 10).await.unwrap(), []);
    assert_eq!(store.list_keys(Some("a"), None, 0).await.unwrap(), []);
    assert_eq!(store.list_keys(None, None, 10).await.unwrap(), [limited.clone(), open.clone()]);

    store.revoke_key(&open.id, 7).await.unwrap();
    store.revoke_key(&open.id, 8).await.unwrap();
    store.note_key_use(&open.id, 9).await.unwrap();
    let ended = Key { revoked_at_ms: Some(7), used_at_ms: Some(9), ..open };
    assert_eq!(store.find_key(&ended.id).await.unwrap(), Some(ended));
    assert_eq!(store.find_key(&limited.id).await.unwrap(), Some(limited));
}

#[tokio::test]
async fn a_command_writes_beside_the_service_and_before_its_first_start() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (key("a"), key("a"));
    // Before the first start there is no store to attach to.
    assert!(matches!(Store::attach(folder.path()).await, Err(StoreError::Folder { .. })));
    let command = Store::open(folder.path()).await.unwrap();
    command.create_key(&first).await.unwrap();
    command.close().await;
    let service = Store::open(folder.path()).await.unwrap();
    let command = Store::attach(folder.path()).await.unwrap();
    command.create_key(&second).await.unwrap();
    command.close().await;
    assert_eq!(service.list_keys(Some("a"), None, 10).await.unwrap(), [first, second]);
}
