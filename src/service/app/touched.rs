//! Findings about a request while it is answered: the objects that it concerns, for its entry in the audit trail, and
//! whether it was executed before.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Maximum number of objects of a kind that an entry names in addition to those of the path.
const MAX_TOUCHED: usize = 32;

/// Objects that a request concerns, whatever name it used for them; recorded where they are looked up.
#[derive(Debug, Clone, Default)]
pub struct Touched {
    ids: Arc<Mutex<BTreeMap<String, String>>>,
    repeats: Arc<AtomicBool>,
}

impl Touched {
    /// Records the id of an object; a second one of the same kind becomes `kind.2`, and so on.
    pub fn note(&self, kind: &str, id: &str) {
        let mut ids = self.ids.lock().unwrap_or_else(PoisonError::into_inner);
        let places = (1..=MAX_TOUCHED).map(|k| if k == 1 { kind.to_owned() } else { format!("{kind}.{k}") });
        for place in places {
            match ids.get(&place) {
                Some(known) if known == id => return,
                Some(_) => {}
                None => {
                    ids.insert(place, id.to_owned());
                    return;
                }
            }
        }
    }

    /// Recorded ids by kind.
    pub fn ids(&self) -> BTreeMap<String, String> {
        self.ids.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Records that the request was executed before, and is answered from its receipt.
    pub fn note_repeat(&self) {
        self.repeats.store(true, Ordering::Relaxed);
    }

    /// Whether the request was executed before.
    pub fn is_repeat(&self) -> bool {
        self.repeats.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_noted_once_each() {
        let touched = Touched::default();
        for id in ["coh_1", "coh_2", "coh_1", "coh_3"] {
            touched.note("cohort_id", id);
        }
        touched.note("shape_id", "shp_1");
        let found: Vec<(String, String)> = touched.ids().into_iter().collect();
        let wanted = [
            ("cohort_id", "coh_1"),
            ("cohort_id.2", "coh_2"),
            ("cohort_id.3", "coh_3"),
            ("shape_id", "shp_1"),
        ];
        assert_eq!(found, wanted.map(|(kind, id)| (kind.to_owned(), id.to_owned())));
        for k in 0..1000 {
            touched.note("cohort_id", &k.to_string());
        }
        assert_eq!(touched.ids().len(), MAX_TOUCHED + 1);
    }
}
