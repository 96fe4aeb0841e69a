//! Loops over entries in parallel, on the threads of the pool that runs the task. Dividing the work among threads is compiled once:
//! it takes thousands of lines of machine code for each type otherwise.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

/// Results of `work` on all items, in their order.
pub(crate) fn map<I: Send, T: Send>(items: Vec<I>, work: impl Fn(usize, I) -> T + Sync) -> Vec<T> {
    let items: Vec<Mutex<Option<I>>> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    map_places(items.len(), |place| {
        let item = items[place].lock().unwrap_or_else(PoisonError::into_inner).take();
        work(place, item.expect("each item is taken once"))
    })
}

/// Results of `work` on all items, in their order.
pub(crate) fn map_ref<I: Sync, T: Send>(items: &[I], work: impl Fn(usize, &I) -> T + Sync) -> Vec<T> {
    map_places(items.len(), |place| work(place, &items[place]))
}

/// Results of `work` for the places of a list of `count` entries.
fn map_places<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let results: Vec<Mutex<Option<T>>> = (0..count).map(|_| Mutex::new(None)).collect();
    for_places(count, &|place| {
        let result = work(place);
        *results[place].lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
    });
    let result = |result: Mutex<Option<T>>| result.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.into_iter().map(|slot| result(slot).expect("each place has its result")).collect()
}

fn for_places(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(work);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_items() {
        let items: Vec<String> = (0..1000).map(|k| k.to_string()).collect();
        let lengths = map_ref(&items, |place, item| (place, item.len()));
        assert!(lengths.iter().zip(0..).all(|((place, _), k)| *place == k));
        assert_eq!(lengths[999], (999, 3));
        assert_eq!(map(items.clone(), |_, item| item), items);
        assert_eq!(map(Vec::<u8>::new(), |_, item| item), []);
    }
}
