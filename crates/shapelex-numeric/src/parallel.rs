//! Loops over all threads, compiled once.
//!
//! The compiler makes a separate family of functions of a parallel iterator for every closure. Here the closure is called through a
//! pointer, once for each item, so an item should take longer than such a call: a shape, not a number. Results are in order, whatever the
//! number of threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

/// Tasks for each thread: items may differ in their work.
const TASKS: usize = 8;

/// Calls `work` with every number below `count`. A single one stays on this thread: handing it over wakes two others.
pub fn for_each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    if count < 2 {
        return (0..count).for_each(work);
    }
    (0..count).into_par_iter().for_each(work);
}

/// `work` of every number below `count`.
pub fn map<T: Send>(count: usize, work: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    let size = count.div_ceil(TASKS * rayon::current_num_threads()).max(1);
    let tasks: Vec<Mutex<Vec<T>>> = (0..count.div_ceil(size)).map(|_| Mutex::default()).collect();
    for_each(tasks.len(), &|task| {
        let done = (task * size..count.min((task + 1) * size)).map(work).collect();
        *tasks[task].lock().unwrap_or_else(PoisonError::into_inner) = done;
    });
    let mut all = Vec::with_capacity(count);
    for task in tasks {
        all.append(&mut task.into_inner().unwrap_or_else(PoisonError::into_inner));
    }
    all
}

/// The same for work that may fail.
///
/// # Errors
/// The error of the smallest number that has one.
pub fn try_map<T: Send, E: Send>(
    count: usize,
    work: &(dyn Fn(usize) -> Result<T, E> + Sync),
) -> Result<Vec<T>, E> {
    // Results after a failure are left out.
    let failed = AtomicUsize::new(usize::MAX);
    let found = map(count, &|k| {
        let wanted = k < failed.load(Ordering::Relaxed);
        let found = wanted.then(|| work(k))?;
        if found.is_err() {
            failed.fetch_min(k, Ordering::Relaxed);
        }
        Some(found)
    });
    found.into_iter().flatten().collect()
}

/// Calls `work` with every chunk of `size` values and its number; the last one may be shorter.
pub fn for_each_chunk<T: Send>(values: &mut [T], size: usize, work: &(dyn Fn(usize, &mut [T]) + Sync)) {
    if values.len() <= size.max(1) {
        return values.chunks_mut(size.max(1)).enumerate().for_each(|(k, chunk)| work(k, chunk));
    }
    values.par_chunks_mut(size.max(1)).enumerate().for_each(|(k, chunk)| work(k, chunk));
}

/// Work on a chunk with this number, which may fail.
pub type TryChunk<'a, T, E> = dyn Fn(usize, &mut [T]) -> Result<(), E> + Sync + 'a;

/// The same for work that may fail; chunks after one that failed may be left as they are.
///
/// # Errors
/// The error of the first chunk that has one.
pub fn try_for_each_chunk<T: Send, E: Send>(
    values: &mut [T],
    size: usize,
    work: &TryChunk<'_, T, E>,
) -> Result<(), E> {
    let first: Mutex<Option<(usize, E)>> = Mutex::new(None);
    let failed = AtomicUsize::new(usize::MAX);
    for_each_chunk(values, size, &|k, chunk| {
        if k > failed.load(Ordering::Relaxed) {
            return;
        }
        let Err(error) = work(k, chunk) else { return };
        failed.fetch_min(k, Ordering::Relaxed);
        let mut first = first.lock().unwrap_or_else(PoisonError::into_inner);
        if first.as_ref().is_none_or(|(before, _)| k < *before) {
            *first = Some((k, error));
        }
    });
    first.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), |(_, error)| Err(error))
}

/// `work` of every chunk of `size` values and its number; the last chunk may be shorter.
pub fn map_chunks<T: Send, R: Send>(
    values: &mut [T],
    size: usize,
    work: &(dyn Fn(usize, &mut [T]) -> R + Sync),
) -> Vec<R> {
    let chunks: Vec<Mutex<&mut [T]>> = values.chunks_mut(size.max(1)).map(Mutex::new).collect();
    map(chunks.len(), &|k| work(k, &mut chunks[k].lock().unwrap_or_else(PoisonError::into_inner)))
}

/// `work` of every value.
pub fn map_each<T: Send, R: Send>(values: &mut [T], work: &(dyn Fn(&mut T) -> R + Sync)) -> Vec<R> {
    let values: Vec<Mutex<&mut T>> = values.iter_mut().map(Mutex::new).collect();
    map(values.len(), &|k| work(&mut values[k].lock().unwrap_or_else(PoisonError::into_inner)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_the_first_failure_is_given() {
        for count in [0, 1, 7, 100, 1000] {
            assert_eq!(map(count, &|k| 3 * k), (0..count).map(|k| 3 * k).collect::<Vec<_>>());
            let fails = |from: usize| try_map(count, &|k| if k >= from { Err(k) } else { Ok(k) });
            assert_eq!(fails(5), if count > 5 { Err(5) } else { Ok((0..count).collect()) });
            assert_eq!(fails(count), Ok((0..count).collect()));
        }
    }

    #[test]
    fn chunks_have_their_number() {
        let mut values = vec![0; 10];
        for_each_chunk(&mut values, 4, &|k, chunk| chunk.fill(k + chunk.len()));
        assert_eq!(values, [4, 4, 4, 4, 5, 5, 5, 5, 4, 4]);
        let refused = try_for_each_chunk(&mut values, 2, &|k, _| if k > 1 { Err(k) } else { Ok(()) });
        assert_eq!(refused, Err(2));
        for_each_chunk::<i32>(&mut [], 0, &|_, _| unreachable!("there is none"));
    }
}
