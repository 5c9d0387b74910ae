//! What a source says while frames are awaited from it.

/// Something a source has to tell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// How things are, for people.
    Note(String),
    /// Something the user should know.
    Warning(String),
    /// The camera went away and is waited for: time to save what is there.
    Gone(String),
    /// It is back.
    Back(String),
}

impl Notice {
    /// The words.
    pub fn text(&self) -> &str {
        match self {
            Self::Note(text) | Self::Warning(text) | Self::Gone(text) | Self::Back(text) => text,
        }
    }
}

/// Takes notices, from the thread that asks the source for frames.
pub type Listener = Box<dyn Fn(Notice) + Send>;
