//! Place recognition: finds the keyframes that show the same place as an image.

mod bow;
mod direct;
mod fabmap;
pub mod features;
mod propose;
mod sequence;
pub mod stored;
mod thumbnail;
mod vocabulary;

pub use bow::{BowIndex, BowParams};
pub use direct::{DirectIndex, Directed, RankParams, ranked, shared_features, words};
pub use fabmap::{FabMap, FabMapParams, Location};
pub use propose::{Proposal, ProposeParams, propose};
pub use sequence::{SequenceParams, supported};
pub use thumbnail::{ThumbnailIndex, ThumbnailParams};
pub use vocabulary::{TrainParams, Vocabulary, VocabularyError, WordBag, WordId};
