//! Recorder of the metrics: atomic numbers for each name and set of labels, and their Prometheus text format (0.0.4).
//!
//! The text lists the families in the order of the table of metrics, their series in the order of their labels.

use std::collections::HashMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use metrics::{Counter, Gauge, GaugeFn, Histogram, HistogramFn, Key, KeyName, Label, Metadata, Recorder};
use metrics::{SharedString, Unit};

/// Type of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A value that only grows.
    Counter,
    /// A value that goes up and down.
    Gauge,
    /// A distribution of durations.
    Histogram,
}

impl Kind {
    /// Name of the type in the Prometheus text format.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram => "histogram",
        }
    }
}

/// Upper bounds of the histograms, in seconds.
const BUCKETS: [f64; 14] =
    [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 30.0, 120.0];

/// Everything counted in this process.
#[derive(Debug, Default)]
pub(super) struct Registry {
    counters: Family<AtomicU64>,
    /// Bits of the values.
    gauges: Family<AtomicU64>,
    histograms: Family<Distribution>,
}

/// Series of one type, by name and labels.
#[derive(Debug)]
struct Family<T>(RwLock<HashMap<Key, Arc<T>>>);

impl<T> Default for Family<T> {
    fn default() -> Self {
        Self(RwLock::default())
    }
}

impl<T: Default> Family<T> {
    fn series(&self, key: &Key) -> Arc<T> {
        let known = self.0.read().unwrap_or_else(PoisonError::into_inner).get(key).cloned();
        known.unwrap_or_else(|| {
            let mut all = self.0.write().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(all.entry(key.clone()).or_default())
        })
    }

    /// Series with this name, in the order of their labels.
    fn of(&self, name: &str) -> Vec<(Key, Arc<T>)> {
        let all = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let named = all.iter().filter(|(key, _)| key.name() == name);
        let mut series: Vec<_> = named.map(|(key, series)| (key.clone(), Arc::clone(series))).collect();
        series.sort_by(|a, b| a.0.cmp(&b.0));
        series
    }
}

/// Number of samples up to each bound and beyond the last, and the bits of their sum.
#[derive(Debug, Default)]
struct Distribution {
    counts: [AtomicU64; BUCKETS.len() + 1],
    sum: AtomicU64,
}

impl HistogramFn for Distribution {
    fn record(&self, value: f64) {
        let bucket = BUCKETS.iter().position(|bound| value <= *bound).unwrap_or(BUCKETS.len());
        self.counts[bucket].fetch_add(1, Ordering::Relaxed);
        GaugeFn::increment(&self.sum, value);
    }
}

impl Recorder for &'static Registry {
    // The table of metrics has the descriptions.
    fn describe_counter(&self, _: KeyName, _: Option<Unit>, _: SharedString) {}
    fn describe_gauge(&self, _: KeyName, _: Option<Unit>, _: SharedString) {}
    fn describe_histogram(&self, _: KeyName, _: Option<Unit>, _: SharedString) {}

    fn register_counter(&self, key: &Key, _: &Metadata<'_>) -> Counter {
        Counter::from_arc(self.counters.series(key))
    }

    fn register_gauge(&self, key: &Key, _: &Metadata<'_>) -> Gauge {
        Gauge::from_arc(self.gauges.series(key))
    }

    fn register_histogram(&self, key: &Key, _: &Metadata<'_>) -> Histogram {
        Histogram::from_arc(self.histograms.series(key))
    }
}

impl Registry {
    /// The metrics of `table`, those without series left out.
    pub(super) fn render(&self, table: &[(&str, Kind, &str)]) -> String {
        let mut text = String::new();
        for &(name, kind, help) in table {
            let start = text.len();
            match kind {
                Kind::Counter => {
                    for (key, value) in self.counters.of(name) {
                        line(&mut text, name, &key, None, value.load(Ordering::Acquire));
                    }
                }
                Kind::Gauge => {
                    for (key, bits) in self.gauges.of(name) {
                        line(&mut text, name, &key, None, f64::from_bits(bits.load(Ordering::Acquire)));
                    }
                }
                Kind::Histogram => {
                    for (key, distribution) in self.histograms.of(name) {
                        distribution.render(&mut text, name, &key);
                    }
                }
            }
            if text.len() > start {
                let head = format!("# HELP {name} {help}\n# TYPE {name} {}\n", kind.as_str());
                text.insert_str(start, &head);
                text.push('\n');
            }
        }
        text
    }
}

impl Distribution {
    fn render(&self, text: &mut String, name: &str, key: &Key) {
        let bucket = format!("{name}_bucket");
        let mut count = 0;
        for (i, samples) in self.counts.iter().enumerate() {
            count += samples.load(Ordering::Acquire);
            let bound = BUCKETS.get(i).map_or_else(|| "+Inf".to_owned(), f64::to_string);
            line(text, &bucket, key, Some(&bound), count);
        }
        let sum = f64::from_bits(self.sum.load(Ordering::Acquire));
        line(text, &format!("{name}_sum"), key, None, sum);
        line(text, &format!("{name}_count"), key, None, count);
    }
}

/// Appends a line of a series; `bound` is that of a bucket.
fn line(text: &mut String, name: &str, key: &Key, bound: Option<&str>, value: impl std::fmt::Display) {
    let label = |label: &Label| format!("{}=\"{}\"", label.key(), escape(label.value()));
    let labels: Vec<String> =
        key.labels().map(label).chain(bound.map(|bound| format!("le=\"{bound}\""))).collect();
    let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
    writeln!(text, "{name}{labels} {value}").expect("writing to a string cannot fail");
}

fn escape(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use metrics::{counter, gauge, histogram, with_local_recorder};

    use super::*;

    #[test]
    fn the_text_has_every_series_in_order() {
        let registry: &'static Registry = Box::leak(Box::default());
        with_local_recorder(&registry, || {
            counter!("b_total", "route" => "/x", "status" => "2xx").increment(2);
            counter!("b_total", "route" => "/a\"\\\n", "status" => "2xx").absolute(7);
            gauge!("a").increment(2.5);
            gauge!("a").decrement(1.0);
            for seconds in [0.001, 0.002, 60.0, 500.0] {
                histogram!("c_seconds", "lane" => "heavy").record(seconds);
            }
            gauge!("not in the table").set(1.0);
        });
        let table = [
            ("c_seconds", Kind::Histogram, "Time"),
            ("b_total", Kind::Counter, "Many"),
            ("none", Kind::Counter, "None"),
            ("a", Kind::Gauge, "One"),
        ];
        let text = registry.render(&table);
        let (histogram, rest) = text.split_once("\n\n").unwrap();
        let lines: Vec<&str> = histogram.lines().collect();
        assert_eq!(lines[..2], ["# HELP c_seconds Time", "# TYPE c_seconds histogram"]);
        assert_eq!(lines[2], "c_seconds_bucket{lane=\"heavy\",le=\"0.001\"} 1");
        assert_eq!(lines[3], "c_seconds_bucket{lane=\"heavy\",le=\"0.0025\"} 2");
        assert_eq!(lines[11], "c_seconds_bucket{lane=\"heavy\",le=\"1\"} 2");
        assert_eq!(lines[15], "c_seconds_bucket{lane=\"heavy\",le=\"120\"} 3");
        assert_eq!(lines[16], "c_seconds_bucket{lane=\"heavy\",le=\"+Inf\"} 4");
        assert_eq!(
            lines[17..],
            ["c_seconds_sum{lane=\"heavy\"} 560.003", "c_seconds_count{lane=\"heavy\"} 4"]
        );
        let wanted = "# HELP b_total Many\n# TYPE b_total counter\nb_total{route=\"/a\\\"\\\\\\n\",status=\"2xx\"} 7\n\
                      b_total{route=\"/x\",status=\"2xx\"} 2\n\n# HELP a One\n# TYPE a gauge\na 1.5\n\n";
        assert_eq!(rest, wanted);
    }
}
