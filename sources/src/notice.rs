//! Notices of a source while the caller waits for frames.

/// A notice of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Information.
    Note(String),
    /// A warning for the user.
    Warning(String),
    /// The camera is gone and the source waits for it; a run saves its map now.
    Gone(String),
    /// The camera is back.
    Back(String),
}

impl Notice {
    /// The text.
    pub fn text(&self) -> &str {
        match self {
            Self::Note(text) | Self::Warning(text) | Self::Gone(text) | Self::Back(text) => text,
        }
    }
}

/// Receives notices, in the thread that asks the source for frames.
pub type Listener = Box<dyn Fn(Notice) + Send>;
