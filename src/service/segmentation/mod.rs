//! Images to shapes. The functions are synchronous and run on the pool, but for [`reference`](mod@reference), [`membership`] and
//! [`job`], which use the store.
//!
//! * [`image`] — images of requests; [`contours`] — boundaries of labels; [`records`] — as records of a file; [`sheets`] — thin surfaces in volumes;
//! * [`posted`] — requests; [`request`] — energies, stages and boxes in them; [`parts`] — requests with their files;
//!   [`starts`] — initial shapes; [`wanted`] — checked settings; [`kinds`] — representations in it; [`cost`] — predictions;
//! * [`segment`] — objects of an image; [`answer`] — answers about them; [`place`] — where they are; [`shown`] — pictures and labels; [`membership`] —
//!   objects that go into a cohort; [`job`] — segmentations that take long;
//! * [`reference`](mod@reference) — means and spans of the store that attract shapes; [`prior`] — the same without an image.
//!
//! The arithmetic is in [`segmentation`](crate::segmentation), the files are read by [`formats::image`](crate::wire::image):
//! this folder limits, predicts and names the answers.

pub mod answer;
pub mod contours;
pub mod cost;
pub mod image;
pub mod job;
pub mod kinds;
pub mod membership;
pub mod parts;
pub mod place;
pub mod posted;
pub mod prior;
pub mod records;
pub mod reference;
pub mod request;
pub mod segment;
pub mod sheets;
pub mod shown;
pub mod starts;
pub mod wanted;
