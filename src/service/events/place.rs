//! Places of event streams: a caller has so many at once, whatever they report, and each ends some time.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::service::access;
use crate::service::app::shares::{Share, Shares};
use crate::service::app::{App, ServiceError};

/// Interval between two checks that the caller is still let in.
const CHECK: Duration = Duration::from_secs(3);
/// Longest duration of a stream. The client reconnects with its credential, which is then checked in full.
const LONGEST: Duration = Duration::from_secs(900);
/// Concurrent streams of a caller.
const MAX_STREAMS: usize = 16;

/// Open streams of all callers.
#[derive(Debug, Default)]
struct Open(Arc<Shares>);

/// Place of a stream among those of its caller, free again when it is dropped.
#[derive(Debug)]
pub struct Place {
    app: App,
    _share: Share,
}

impl Place {
    /// A place for a stream of the caller.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if the caller has as many as it may.
    pub fn take(app: &App) -> Result<Self, ServiceError> {
        let share = app.state::<Open>().0.take(app.principal.caller(), MAX_STREAMS).ok_or_else(|| {
            let detail =
                format!("expected at most {MAX_STREAMS} open event streams of a caller, got one more");
            ServiceError::Overloaded(detail)
        })?;
        Ok(Self { app: app.clone(), _share: share })
    }

    /// Resolves when the stream must end, because it has lasted long enough or its caller would not be let in any more.
    pub async fn is_over(self) {
        let end = Instant::now() + LONGEST;
        while Instant::now() < end {
            tokio::time::sleep(CHECK).await;
            match access::still_admits(&self.app).await {
                Ok(true) => {}
                Ok(false) => return,
                Err(error) => {
                    // The response head is already sent: the client reconnects, and then gets the error.
                    tracing::warn!(
                        error = error.cause(),
                        "the caller of a stream cannot be checked: the stream ends"
                    );
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::app::Limits;
    use crate::store::Store;

    #[tokio::test]
    async fn places_of_a_caller_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let app = App::new(Store::open(folder.path()).await.unwrap(), Limits::default(), 1);
        let mut places: Vec<Place> = (0..MAX_STREAMS).map(|_| Place::take(&app).unwrap()).collect();
        let refused = Place::take(&app);
        assert!(matches!(refused, Err(ServiceError::Overloaded(_))), "{refused:?}");
        places.pop();
        Place::take(&app).unwrap();
    }
}
