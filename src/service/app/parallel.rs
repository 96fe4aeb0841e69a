//! Loops over entries in parallel, on the threads of the pool that runs the task, by the loop of [`shapelex_numeric::parallel`].

use std::sync::{Mutex, PoisonError};

use shapelex_numeric::parallel;

/// Results of `work` on all items, in their order.
pub(crate) fn map<I: Send, T: Send>(items: Vec<I>, work: impl Fn(usize, I) -> T + Sync) -> Vec<T> {
    let items: Vec<Mutex<Option<I>>> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    parallel::map(items.len(), &|place| {
        let item = items[place].lock().unwrap_or_else(PoisonError::into_inner).take();
        work(place, item.expect("each item is taken once"))
    })
}

/// Results of `work` on all items, in their order.
pub(crate) fn map_ref<I: Sync, T: Send>(items: &[I], work: impl Fn(usize, &I) -> T + Sync) -> Vec<T> {
    parallel::map(items.len(), &|place| work(place, &items[place]))
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
        assert!(map(Vec::<u8>::new(), |_, item| item).is_empty());
    }
}
