//! Successive changes of a job.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch::Receiver;
use tokio::time::Instant;

use super::read;
use crate::domain::job::{Job, JobStatus, Progress};
use crate::service::app::progress::Channel;
use crate::service::app::{App, ServiceError};

/// Minimum time between two reports of progress; changes of the status are reported at once.
const PACE: Duration = Duration::from_millis(200);

/// Polling interval of the row, for changes by other replicas.
pub(super) const LOOK: Duration = Duration::from_millis(500);

/// Age from which on values read by another watcher are read again.
pub(super) const FRESH: Duration = Duration::from_millis(250);

/// Age from which on the row is read again after a report of progress, which is not in it.
const PROGRESS: Duration = Duration::from_millis(150);

/// Minimum time between two reports of a running job whose progress stands still: its estimate changes, and its client sees
/// that it goes on.
const BEAT: Duration = Duration::from_millis(700);

/// States of a job from the current to the final one.
#[derive(Debug)]
pub struct Watch {
    app: App,
    id: String,
    states: Receiver<()>,
    progress: Receiver<Progress>,
    told: Option<Job>,
    /// Age of a reading by other watchers that will do; `None` before the first.
    age: Option<Duration>,
    /// Earliest time of the next report of progress.
    next: Instant,
    /// Earliest time at which an unchanged running job is reported.
    beat: Instant,
    /// Owns the sender of both receivers.
    channel: Arc<Channel>,
}

impl Watch {
    /// Watches the job with this id. The state that the client already knows is not reported again.
    pub fn new(app: &App, id: &str, known: Option<Job>) -> Self {
        let channel = app.registry().channel(id);
        Self {
            app: app.clone(),
            id: id.into(),
            states: channel.states(),
            progress: channel.progress(),
            told: known,
            age: None,
            next: Instant::now(),
            beat: Instant::now() + BEAT,
            channel,
        }
    }

    /// Next state that differs from the last reported one, or a running one after a while; the first is available at once. `None` after the final
    /// state, or when the service is stopping.
    ///
    /// # Errors
    /// [`ServiceError::NotFound`], also if the job has been removed from the history in the meantime.
    pub async fn next(&mut self) -> Result<Option<Job>, ServiceError> {
        loop {
            // Without waiting for a change, continuous progress would be reported continuously.
            if self.age.is_some() && (self.is_over() || !self.changed().await) {
                return Ok(None);
            }
            let age = *self.age.get_or_insert_default();
            let job = read(&self.app, &self.id, &self.channel, age).await?;
            let goes_on = job.status == JobStatus::Running && Instant::now() >= self.beat;
            if goes_on || self.told.as_ref() != Some(&job) {
                self.next = Instant::now() + PACE;
                self.beat = Instant::now() + BEAT;
                self.told = Some(job.clone());
                return Ok(Some(job));
            }
        }
    }

    fn is_over(&self) -> bool {
        self.told.as_ref().is_some_and(|job| job.status.is_finished())
    }

    /// Waits until there may be news; `false` when the service is stopping.
    async fn changed(&mut self) -> bool {
        let paced = async {
            tokio::time::sleep_until(self.next).await;
            self.progress.changed().await
        };
        let age = tokio::select! {
            // The channel held here owns the sender, so there always is one.
            _ = self.states.changed() => Duration::ZERO,
            // Another replica may be running it.
            () = tokio::time::sleep(LOOK) => FRESH,
            _ = paced => PROGRESS,
            () = self.app.stopping() => return false,
        };
        self.age = Some(age);
        true
    }
}
