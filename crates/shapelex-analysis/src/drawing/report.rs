//! Drawings of report cards: four plots against the number of modes or subjects.

use crate::dictionary::report::{Errors, Interval, LearningPoint, ModeReport, ReportCard};
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::plot::{Graph, Panel, panels};
use shapelex_geometry::drawing::scene::{Drawing, short};

/// Drawing of compactness, errors, stability and learning curve. `unit`: the unit of lengths.
pub fn draw_report(title: &str, report: &ReportCard, unit: Option<&str>) -> Drawing {
    let in_unit = unit.map_or_else(String::new, |unit| format!(" ({unit})"));
    let drawn =
        vec![compactness(report), errors(report, &in_unit), stability(report), learning(report, &in_unit)];
    let mut legend = vec![Entry::Text(format!(
        "{} shapes of {} subjects; bars: intervals that cover 95 %",
        report.shapes, report.subjects
    ))];
    for measurement in &report.measurements {
        let most = measurement.modes.iter().max_by(|a, b| a.change.abs().total_cmp(&b.change.abs()));
        let unit = measurement.unit.as_deref().map_or_else(String::new, |unit| format!(" {unit}"));
        let changed = most.map_or_else(String::new, |mode| {
            format!(
                "; mode {} changes it by {}{unit} per standard deviation",
                mode.component,
                short(mode.change)
            )
        });
        let (mean, deviation) = (short(measurement.mean), short(measurement.deviation));
        legend.push(Entry::Text(format!("{}: {mean} ± {deviation}{unit}{changed}", measurement.name)));
    }
    legend.extend(report.warnings.iter().cloned().map(Entry::Text));
    panels(title, drawn).with_legend(&legend)
}

/// A graph of values with their intervals, for `x` from `first` on.
fn graph(name: &str, colour: Colour, first: usize, values: &[Interval]) -> (Graph, Vec<[f64; 3]>) {
    let at = |i: usize| (first + i) as f64;
    let points = values.iter().enumerate().map(|(i, interval)| [at(i), interval.value]).collect();
    let bars = values.iter().enumerate();
    let bars = bars.filter_map(|(i, Interval { low, high, .. })| Some([at(i), (*low)?, (*high)?])).collect();
    (Graph { name: name.into(), colour, pieces: vec![points] }, bars)
}

fn of_modes(report: &ReportCard, get: impl Fn(&ModeReport) -> Interval) -> Vec<Interval> {
    report.modes.iter().map(get).collect()
}

fn compactness(report: &ReportCard) -> Panel {
    let values = of_modes(report, |mode| mode.compactness);
    Panel {
        title: "compactness: explained variance".into(),
        variable: "modes".into(),
        graphs: vec![graph("together", colour::MAIN, 1, &values)],
    }
}

fn errors(report: &ReportCard, in_unit: &str) -> Panel {
    let of = |get: fn(&Errors) -> Interval| -> Vec<Interval> {
        [get(&report.mean_only)].into_iter().chain(of_modes(report, |mode| get(&mode.errors))).collect()
    };
    Panel {
        title: format!("errors to corresponding points{in_unit}"),
        variable: "modes".into(),
        graphs: vec![
            graph("generalisation", colour::MINUS, 0, &of(|errors| errors.generalisation)),
            graph("specificity", colour::PLUS, 0, &of(|errors| errors.specificity)),
        ],
    }
}

fn stability(report: &ReportCard) -> Panel {
    let angles = |get: fn(&ModeReport) -> Option<crate::dictionary::report::Angle>| -> Vec<Interval> {
        let known = report.modes.iter().filter_map(get);
        known.map(|angle| Interval { value: angle.median, low: None, high: None }).collect()
    };
    Panel {
        title: "stability: angles when resampled (°)".into(),
        variable: "mode".into(),
        graphs: vec![
            graph("single modes", colour::MINUS, 1, &angles(|mode| mode.angle_deg)),
            graph("their span", colour::PLUS, 1, &angles(|mode| mode.span_angle_deg)),
        ],
    }
}

fn learning(report: &ReportCard, in_unit: &str) -> Panel {
    let point = |point: &LearningPoint| [point.subjects as f64, point.generalisation.value];
    let bar = |point: &LearningPoint| {
        let Interval { low, high, .. } = point.generalisation;
        Some([point.subjects as f64, low?, high?])
    };
    let graph = Graph {
        name: "generalisation with all modes".into(),
        colour: colour::MINUS,
        pieces: vec![report.learning_curve.iter().map(point).collect()],
    };
    Panel {
        title: format!("learning curve{in_unit}"),
        variable: "subjects".into(),
        graphs: vec![(graph, report.learning_curve.iter().filter_map(bar).collect())],
    }
}
