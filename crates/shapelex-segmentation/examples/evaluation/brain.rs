//! Time and memory of a brain of 181 × 217 × 181 voxels, each task in a process of its own.

use std::process::Command;
use std::time::Instant;

use shapelex_numeric::bounded::never;
use shapelex_segmentation::detector::{Innermost, Sheets, innermost, largest_component};
use shapelex_segmentation::energy::Polarity;
use shapelex_segmentation::field::Image;
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::scene::{ImageTerm, Scene};
use shapelex_segmentation::run::segment;
use shapelex_segmentation::snake::reparametrisation::Free;

use crate::phantoms::{head_distance, head_value};
use crate::tasks::{cells, dice, ellipsoid, jaccard, nucleus_settings, tied_sphere};

const SIZE: [usize; 3] = [181, 217, 181];
const CENTRE: [f64; 3] = [86.0, 104.0, 92.0];

/// The tasks, in processes of their own, so that each has a peak of memory.
pub(crate) fn section() -> std::io::Result<String> {
    let mut page = String::from(
        "
## Time and memory of a brain

The head at 1 mm, 181 × 217 × 181 voxels. Fields and segmentation: threshold energy, `θ = 0.6`, `σ` of 2 and 1 mm, tied sphere of 9 × 9
intervals. Detector: dark sheets at 4 mm, crests, innermost surface, largest component. Seconds of processor time are those of all
threads; the peak of memory is that of the whole process, with the image.

| task | result | seconds | processor seconds | peak of memory, MB |
|---|---|---|---|---|
",
    );
    for task in ["segmentation", "detector"] {
        let output = Command::new(std::env::current_exe()?).args(["--brain", task]).output()?;
        page += &String::from_utf8_lossy(&output.stdout);
    }
    Ok(page)
}

/// One task; the row of the table.
pub(crate) fn row(task: &str) -> std::io::Result<String> {
    let at = |cell: usize| [cell % SIZE[0], cell / SIZE[0] % SIZE[1], cell / SIZE[0] / SIZE[1]];
    let half = |cell: [usize; 3]| cell.map(|i| i as f64 / 2.0);
    let values = (0..SIZE.iter().product()).map(|cell| head_value(half(at(cell))) as f32).collect();
    let head: Image<f32> = Image::new(SIZE, values).map_err(std::io::Error::other)?;
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let frame = Frame::new(axes, [-90.0, -108.0, -90.0]).map_err(std::io::Error::other)?;
    let (clock, before) = (Instant::now(), processor_seconds()?);
    let (result, seconds) = if task == "detector" {
        let sheets: Option<Sheets<f32>> =
            Sheets::new(&head, &frame, 4.0, Polarity::Dark, &never).map_err(std::io::Error::other)?;
        let sheets = sheets.expect("no stop");
        let crests = sheets.crests(sheets.threshold(0.3, 99.0), &never).expect("no stop");
        let surface = innermost(&sheets, &crests, &Innermost::around(CENTRE, 20.0, &frame));
        let count = largest_component(&surface, SIZE).len();
        (format!("{count} cells"), clock.elapsed().as_secs_f64())
    } else {
        let terms = [(ImageTerm::Threshold { theta: 0.6, level: None }, 1.0)];
        let scene = Scene::new(&head, frame, &terms, &[2.0, 1.0]);
        drop(head);
        let stages = [(Free::Radial, 2.0), (Free::All, 2.0), (Free::All, 1.0)];
        let (model, start) = (tied_sphere(), ellipsoid(9, 9, [45.0, 55.0, 40.0], CENTRE));
        let found = segment(&scene, &model, &start, &nucleus_settings(&stages), &never);
        let seconds = clock.elapsed().as_secs_f64();
        let rows = found.map_err(std::io::Error::other)?.rows;
        let truth = |cell: [f64; 3]| head_distance(cell.map(|i| i / 2.0)) <= 3.0;
        (format!("Dice {:.3}", dice(jaccard(&cells(&model, &rows, SIZE), truth))), seconds)
    };
    let processor = processor_seconds()? - before;
    Ok(format!("| {task} | {result} | {seconds:.1} | {processor:.1} | {:.0} |\n", peak_megabytes()?))
}

/// Processor time of the user by all threads of this process; the clock of Linux has hundredths of a second.
fn processor_seconds() -> std::io::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().nth(11).and_then(|ticks| ticks.parse::<f64>().ok());
    ticks.map(|ticks| ticks / 100.0).ok_or_else(|| std::io::Error::other("expected times in /proc/self/stat"))
}

/// Largest resident memory of this process.
fn peak_megabytes() -> std::io::Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes =
        peak.and_then(|line| line.split_whitespace().next()).and_then(|kb| kb.parse::<f64>().ok());
    kilobytes.map(|kb| kb / 1e3).ok_or_else(|| std::io::Error::other("expected VmHWM in /proc/self/status"))
}
