//! Secrets of tenants, by which identifiers of persons become subjects.

use super::answer::Answer;
use super::engine::sql;
use super::error::StoreError;
use super::handle::Store;

const FIND: &str = "SELECT secret FROM subject_secret WHERE tenant = $1";

impl Store {
    /// The secret of the tenant, if one is stored.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_subject_secret(&self) -> Answer<'_, Option<Vec<u8>>> {
        Box::pin(async move {
            let row = sql(self.reader(), FIND).bind(self.tenant()).optional().await?;
            Ok(row.map(|row| row.get("secret")).transpose()?)
        })
    }

    /// The secret of the tenant: that which is stored, else `fresh`, which is stored then.
    ///
    /// # Errors
    /// Database errors.
    pub fn subject_secret<'a>(&'a self, fresh: &'a [u8]) -> Answer<'a, Vec<u8>> {
        Box::pin(async move {
            const KEEP: &str = "INSERT INTO subject_secret (tenant, secret) VALUES ($1, $2)
                ON CONFLICT (tenant) DO NOTHING";
            if let Some(secret) = self.find_subject_secret().await? {
                return Ok(secret);
            }
            sql(self.writer(), KEEP).bind(self.tenant()).bind(fresh).execute().await?;
            // Another process may have been first.
            let row = sql(self.writer(), FIND).bind(self.tenant()).optional().await?;
            let missing = || StoreError::Damaged { detail: "a secret that was stored is missing".into() };
            Ok(row.ok_or_else(missing)?.get("secret")?)
        })
    }
}
