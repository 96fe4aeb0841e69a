//! Logs: structured lines on standard error, filtered, as text or JSON. Never a body, never a coordinate.
//!
//! With the feature `otel`, and when an endpoint is set in the environment, spans are also sent there as traces.

#[cfg(feature = "otel")]
mod traces;

use std::io::IsTerminal;

use tokio::runtime::Handle;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use crate::config::LogFormat;

/// What has to be brought to an end with the program.
#[must_use]
#[derive(Debug)]
pub struct Telemetry {
    #[cfg(feature = "otel")]
    traces: Option<traces::Traces>,
}

/// Starts logging, and tracing when it is asked for; traces are sent on the runtime of `handle`.
///
/// # Errors
/// A filter that cannot be read; an endpoint for traces that is none.
pub fn start(filter: &str, format: LogFormat, handle: &Handle) -> Result<Telemetry, String> {
    let filter = EnvFilter::try_new(filter).map_err(|error| format!("log filter '{filter}': {error}"))?;
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
    // A log on a full disk cannot be told there that it is full; trying to would end the request.
    let lines = lines.log_internal_errors(false);
    let lines = match format {
        LogFormat::Text => lines.boxed(),
        LogFormat::Json => lines.json().boxed(),
    };
    let subscriber = tracing_subscriber::registry().with(lines.with_filter(filter));
    #[cfg(feature = "otel")]
    {
        let traces = traces::Traces::start(handle)?;
        let layer = traces.as_ref().map(traces::Traces::layer);
        subscriber.with(layer).try_init().map_err(|error| error.to_string())?;
        Ok(Telemetry { traces })
    }
    #[cfg(not(feature = "otel"))]
    {
        // Only traces are sent.
        let _ = handle;
        subscriber.try_init().map_err(|error| error.to_string())?;
        Ok(Telemetry {})
    }
}

impl Telemetry {
    /// Sends what was not sent yet.
    pub fn stop(self) {
        #[cfg(feature = "otel")]
        if let Some(traces) = self.traces {
            traces.stop();
        }
    }
}
