//! Audit trail: chains, filters, expiry, and detection of tampering.

use super::*;
use crate::domain::audit::{AuditFilter, Entry};

fn entry(tenant: &str, at_ms: i64, cohort: &str) -> Entry {
    Entry {
        at_ms,
        tenant: tenant.into(),
        key: Some("key_1".into()),
        operation: Some("find_cohort".into()),
        method: "GET".into(),
        route: Some("/v1/cohorts/{cohort}".into()),
        objects: BTreeMap::from([("cohort".to_owned(), cohort.to_owned())]),
        status: Some(200),
        ..Entry::default()
    }
}

async fn places(store: &Store, tenant: &str, filter: &AuditFilter) -> Vec<u64> {
    let found = store.list_audit(tenant, filter, 0, 100).await.unwrap();
    found.iter().map(|recorded| recorded.sequence).collect()
}

#[tokio::test]
async fn tenants_have_chains_of_their_own_that_go_on_from_group_to_group() {
    let (_folder, store) = fresh().await;
    store.append_audit(&[entry("a", 1, "x"), entry("b", 2, "x"), entry("a", 3, "y")]).await.unwrap();
    store.append_audit(&[entry("a", 4, "x")]).await.unwrap();
    assert_eq!(places(&store, "a", &AuditFilter::default()).await, [1, 2, 3]);
    assert_eq!(places(&store, "b", &AuditFilter::default()).await, [1]);
    assert_eq!(places(&store, "c", &AuditFilter::default()).await, [0; 0]);
    assert_eq!(store.check_audit().await.unwrap(), AuditCheck { tenants: 2, entries: 4 });
    let found = store.list_audit("a", &AuditFilter::default(), 1, 1).await.unwrap();
    assert_eq!((found.len(), &found[0].entry), (1, &entry("a", 3, "y")));
}

#[tokio::test]
async fn filters_select() {
    let (_folder, store) = fresh().await;
    let minutes = |count: i64| count * 60_000;
    let mut entries: Vec<Entry> = (0..6).map(|k| entry("a", minutes(k), "x")).collect();
    entries[1].key = Some("key_2".into());
    entries[2].operation = None;
    entries[3].objects.insert("cohort".into(), "X\"%_".into());
    entries[4].status = None;
    store.append_audit(&entries).await.unwrap();
    let all = AuditFilter::default();
    let some = |text: &str| Some(text.to_owned());
    let since = AuditFilter { since_ms: Some(minutes(3)), ..all.clone() };
    assert_eq!(places(&store, "a", &since).await, [4, 5, 6]);
    let later = AuditFilter { since_ms: Some(minutes(30)), ..all.clone() };
    assert_eq!(places(&store, "a", &later).await, [0; 0]);
    let until = AuditFilter { until_ms: Some(minutes(2)), ..all.clone() };
    assert_eq!(places(&store, "a", &until).await, [1, 2]);
    let of_key = AuditFilter { key: some("key_2"), ..all.clone() };
    assert_eq!(places(&store, "a", &of_key).await, [2]);
    let of_operation = AuditFilter { operation: some("find_cohort"), ..all.clone() };
    assert_eq!(places(&store, "a", &of_operation).await, [1, 2, 4, 5, 6]);
    let of_object = |object| AuditFilter { object: some(object), ..all.clone() };
    assert_eq!(places(&store, "a", &of_object("X\"%_")).await, [4]);
    assert_eq!(places(&store, "a", &of_object("x")).await, [1, 2, 3, 5, 6]);
    assert_eq!(places(&store, "a", &of_object("cohort")).await, [0; 0]);
    let of_status = AuditFilter { status: Some(200), ..all };
    assert_eq!(places(&store, "a", &of_status).await, [1, 2, 3, 4, 6]);
}

#[tokio::test]
async fn what_is_old_goes_and_the_chain_stays_whole() {
    let (_folder, store) = fresh().await;
    let entries: Vec<Entry> = (0..10).map(|k| entry("a", k, "x")).collect();
    store.append_audit(&entries).await.unwrap();
    store.append_audit(&[entry("b", 3, "x")]).await.unwrap();
    assert_eq!(store.prune_audit(4).await.unwrap(), 5);
    assert_eq!(places(&store, "a", &AuditFilter::default()).await, [5, 6, 7, 8, 9, 10]);
    assert_eq!(store.check_audit().await.unwrap(), AuditCheck { tenants: 2, entries: 6 });
    store.append_audit(&[entry("a", 11, "x"), entry("b", 11, "x")]).await.unwrap();
    assert_eq!(store.check_audit().await.unwrap(), AuditCheck { tenants: 2, entries: 8 });
    assert_eq!(store.prune_audit(i64::MAX).await.unwrap(), 8);
    assert_eq!(store.check_audit().await.unwrap(), AuditCheck { tenants: 2, entries: 0 });
}

#[tokio::test]
async fn every_change_of_the_trail_is_found() {
    const CHANGES: [(&str, u64); 6] = [
        ("UPDATE audit SET status = 403 WHERE sequence = 4", 4),
        ("UPDATE audit SET objects = '{}' WHERE sequence = 1", 1),
        ("DELETE FROM audit WHERE sequence = 3", 3),
        ("DELETE FROM audit WHERE sequence = 5", 5),
        ("DELETE FROM audit WHERE sequence = 1", 1),
        ("UPDATE audit_head SET digest = removed_digest", 5),
    ];
    for (change, place) in CHANGES {
        let (_folder, store) = fresh().await;
        let entries: Vec<Entry> = (0..5).map(|k| entry("a", k, "x")).collect();
        store.append_audit(&entries).await.unwrap();
        sql(store.writer(), change).execute().await.unwrap();
        let found = store.check_audit().await.map_err(|error| match error {
            StoreError::Damaged { detail } => detail,
            other => other.to_string(),
        });
        assert_eq!(found, Err(format!("the audit trail of tenant \"a\" is broken at entry {place}")));
    }
}
