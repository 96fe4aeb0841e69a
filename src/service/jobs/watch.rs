//! The changes of a job, one after the other.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch::Receiver;
use tokio::time::Instant;

use super::find;
use crate::domain::job::{Job, Progress};
use crate::service::app::progress::Channel;
use crate::service::app::{App, ServiceError};

/// Shortest time between two reports of progress; changes of the status are told at once.
const PACE: Duration = Duration::from_millis(200);

/// How often the row is looked at when nobody says that it has changed.
pub(super) const LOOK: Duration = Duration::from_secs(1);

/// The states of a job from the present one to the final one.
#[derive(Debug)]
pub struct Watch {
    app: App,
    id: String,
    states: Receiver<()>,
    progress: Receiver<Progress>,
    told: Option<Job>,
    begun: bool,
    /// When progress may be told again.
    next: Instant,
    /// The sender of both receivers.
    _channel: Arc<Channel>,
}

impl Watch {
    /// Watches the job with this id. When the client says what it knows already, that is not told again.
    pub fn new(app: &App, id: &str, known: Option<Job>) -> Self {
        let channel = app.registry().channel(id);
        Self {
            app: app.clone(),
            id: id.into(),
            states: channel.states(),
            progress: channel.progress(),
            told: known,
            begun: false,
            next: Instant::now(),
            _channel: channel,
        }
    }

    /// The job when it is another than was told last, at first at once; none after the final state, or when the
    /// service is asked to stop.
    ///
    /// # Errors
    /// [`ServiceError::NotFound`], also when the job has left the history meanwhile.
    pub async fn next(&mut self) -> Result<Option<Job>, ServiceError> {
        loop {
            // Without waiting for a change what is reported all the time would be told all the time.
            if self.begun && (self.is_over() || !self.changed().await) {
                return Ok(None);
            }
            self.begun = true;
            let job = find(&self.app, &self.id).await?;
            if self.told.as_ref() != Some(&job) {
                self.next = Instant::now() + PACE;
                self.told = Some(job.clone());
                return Ok(Some(job));
            }
        }
    }

    fn is_over(&self) -> bool {
        self.told.as_ref().is_some_and(|job| job.status.is_finished())
    }

    /// Waits until there may be news; false when the service is asked to stop.
    async fn changed(&mut self) -> bool {
        let paced = async {
            tokio::time::sleep_until(self.next).await;
            self.progress.changed().await
        };
        tokio::select! {
            // The channel, which is held here, is what sends: there is always a sender.
            _ = self.states.changed() => true,
            // Another process may work on it.
            () = tokio::time::sleep(LOOK) => true,
            _ = paced => true,
            () = self.app.stopping() => false,
        }
    }
}
