//! Claims of hooks.

use super::*;
use crate::domain::change::ChangeFilter;
use crate::domain::hook::{Hook, HookStatus, SigningSecret};

/// Stores a hook of the tenant that is due at this time.
async fn add(store: &Store, tenant: &str, due_ms: i64) -> Hook {
    let hook = Hook {
        id: id::new_id(id::HOOK),
        tenant: tenant.into(),
        url: "https://receiver.example/in".into(),
        description: String::new(),
        filter: ChangeFilter::default(),
        secret: SigningSecret::new(vec![7; 32]),
        status: HookStatus::Active,
        reason: None,
        position: 0,
        attempts: 0,
        failing_since_ms: None,
        due_ms,
        delivered_at_ms: None,
        created_at_ms: due_ms,
    };
    assert!(store.create_hook(&hook).await.unwrap());
    hook
}

/// Something to deliver to the hooks of the tenant.
async fn change(store: &Store, tenant: &str) {
    let store = store.of(Arc::new(Principal::system(tenant)));
    store.create_cohort(&cohort("hands"), None).await.unwrap();
}

/// Tenants of the hooks that are claimed, one after the other.
async fn claimed(store: &Store, count: usize, crowding: &[&str]) -> String {
    let mut tenants = String::new();
    for _ in 0..count {
        let claim = store.claim_hook(1000, 9000, crowding).await.unwrap();
        tenants += claim.as_ref().map_or("-", |claim| claim.hook.tenant.as_str());
    }
    tenants
}

#[tokio::test]
async fn hooks_of_tenants_are_claimed_in_turn() {
    let (_folder, store) = fresh().await;
    for tenant in ["a", "b"] {
        change(&store, tenant).await;
    }
    for k in 0..5 {
        add(&store, "a", k).await;
    }
    // They have waited for less time than all of the other tenant.
    for k in 0..2 {
        add(&store, "b", 100 + k).await;
    }
    add(&store, "c", 0).await;
    assert_eq!(claimed(&store, 8, &[]).await, "ababaaa-", "nothing is to be delivered for c");
}

#[tokio::test]
async fn a_crowding_tenant_waits_while_others_have_hooks() {
    let (_folder, store) = fresh().await;
    for tenant in ["a", "b"] {
        change(&store, tenant).await;
    }
    for k in 0..3 {
        add(&store, "a", k).await;
    }
    assert_eq!(claimed(&store, 1, &["a"]).await, "a", "nobody else has hooks");
    let other = add(&store, "b", 0).await;
    assert_eq!(claimed(&store, 2, &["a"]).await, "b-");
    store
        .of(Arc::new(Principal::system("b")))
        .set_hook_status(&other.id, HookStatus::Paused, 0)
        .await
        .unwrap();
    assert_eq!(claimed(&store, 3, &["a"]).await, "aa-");
}
