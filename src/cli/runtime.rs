//! The async runtime of the program.

/// A runtime on all cores.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, String> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .on_thread_start(compute_alone)
        .build()
        .map_err(|error| format!("the async runtime cannot start: {error}"))?;
    {
        let _inside = runtime.enter();
        outlive_file_limit()?;
    }
    Ok(runtime)
}

/// Makes loops of small computations run on this thread alone; otherwise they would wait for threads on all cores.
fn compute_alone() {
    thread_local! {
        static ALONE: Option<rayon::ThreadPool> =
            rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().ok();
    }
    ALONE.with(|_| ());
}

/// Catches SIGXFSZ. Writing to a file at the size limit (`ulimit -f`) then returns an error that can be handled, where the
/// signal would end the process.
#[cfg(unix)]
fn outlive_file_limit() -> Result<(), String> {
    use tokio::signal::unix::{SignalKind, signal};
    let kind = SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw());
    // The handler stays installed after the listener is dropped.
    signal(kind).map(drop).map_err(|error| format!("signals cannot be handled: {error}"))
}

#[cfg(not(unix))]
fn outlive_file_limit() -> Result<(), String> {
    Ok(())
}
