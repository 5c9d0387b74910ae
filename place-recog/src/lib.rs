//! Place recognition: finds the keyframes that show the same place as an image.

mod bow;
mod common;
mod direct;
mod fabmap;
mod feature_words;
mod keyframe_features;
mod propose;
mod sequence;
mod thumbnail;
mod vocabulary;

pub use bow::{BowIndex, BowParams};
pub use common::{Appearance, CommonIndex, IndexMethod};
pub use direct::{DirectIndex, Directed, RankParams, ranked, shared_features, words};
pub use fabmap::{FabMap, FabMapParams, Location};
pub use feature_words::FeatureWords;
pub use features;
pub use keyframe_features::KeyframeFeatures;
pub use propose::{Proposal, ProposeParams, propose};
pub use sequence::{SequenceParams, supported};
pub use thumbnail::{ThumbnailIndex, ThumbnailParams};
pub use vocabulary::{TrainParams, Vocabulary, VocabularyError, WordBag, WordId};
