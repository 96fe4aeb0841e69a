//! Logs: structured lines on standard error, filtered, as text or JSON. Bodies and coordinates are never logged.
//!
//! With the feature `otel` and an endpoint set in the environment, spans are also exported as traces.

#[cfg(feature = "otel")]
mod traces;

use std::io::IsTerminal;

use tokio::runtime::Handle;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{ParseError, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::config::LogFormat;

/// Telemetry to shut down at the end of the program.
#[must_use]
#[derive(Debug)]
pub struct Telemetry {
    #[cfg(feature = "otel")]
    traces: Option<traces::Traces>,
}

/// Starts logging, and tracing if configured; traces are exported on the runtime of `handle`.
///
/// # Errors
/// An invalid filter; an invalid endpoint for traces.
pub fn start(filter: &str, format: LogFormat, handle: &Handle) -> Result<Telemetry, String> {
    let filter = targets(filter).map_err(|error| format!("log filter '{filter}': {error}"))?;
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
    // A full disk cannot be reported in a log on that disk; attempting to would end the request.
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
        // Used for traces only.
        let _ = handle;
        subscriber.try_init().map_err(|error| error.to_string())?;
        Ok(Telemetry {})
    }
}

/// Parses a list of levels and of `target=level`; without any, errors are logged.
fn targets(filter: &str) -> Result<Targets, ParseError> {
    // An empty entry would stand for the level `error`.
    let entries: Vec<&str> = filter.split(',').map(str::trim).filter(|entry| !entry.is_empty()).collect();
    entries.join(",").parse()
}

impl Telemetry {
    /// Exports pending spans.
    pub fn stop(self) {
        #[cfg(feature = "otel")]
        if let Some(traces) = self.traces {
            traces.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use tracing::Level;

    use super::*;

    #[test]
    fn filters_are_lists_of_levels_and_targets() {
        let passes =
            |filter: &str, target: &str, level: Level| targets(filter).unwrap().would_enable(target, &level);
        for filter in ["info", "INFO,", "warn,shapelex=info", "off, shapelex_server::api=info", "3"] {
            assert!(passes(filter, "shapelex_server::api", Level::INFO), "{filter}");
            assert!(!passes(filter, "shapelex_server::api", Level::DEBUG), "{filter}");
        }
        assert!(passes("", "shapelex_server", Level::ERROR) && !passes("", "shapelex_server", Level::WARN));
        assert!(passes("warn,shapelex", "shapelex_server::store", Level::TRACE));
        assert!(targets("shapelex=loud").is_err() && targets("a=b=c").is_err());
    }
}
