//! Place recognition: finds the keyframes that show the same place as an image.

mod bow;
pub mod features;
mod thumbnail;
mod vocabulary;

pub use bow::{BowIndex, BowParams};
pub use thumbnail::{ThumbnailIndex, ThumbnailParams};
pub use vocabulary::{TrainParams, Vocabulary, VocabularyError, WordBag, WordId};
