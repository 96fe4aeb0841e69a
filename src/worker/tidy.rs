//! What is due by the clock: the trash past its term, receipts past their time.

use std::time::Duration;

use crate::service::{App, trash};

/// How often it is looked at.
const EVERY: Duration = Duration::from_secs(600);

/// Removes what is due until the service is asked to stop. `trash_days`: how long deleted things can come back.
pub async fn keep_tidy(app: App, trash_days: u32) {
    let mut ticks = tokio::time::interval(EVERY);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = app.stopping() => return,
        }
        if let Err(error) = trash::tidy(&app, trash_days).await {
            tracing::warn!(error = error.cause(), "what is due to be removed could not be removed");
        }
    }
}
