//! Values that several hold and one may change.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// A value that is cheap to hand on: copies share it until one of them is changed, which then gets its own.
///
/// So a part of a map can be read elsewhere (tracked against, written to a file, shown) while it is worked on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shared<T>(Arc<T>);

impl<T> From<T> for Shared<T> {
    fn from(value: T) -> Self {
        Self(Arc::new(value))
    }
}

impl<T> Deref for Shared<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Clone> DerefMut for Shared<T> {
    fn deref_mut(&mut self) -> &mut T {
        Arc::make_mut(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_share_until_one_is_changed() {
        let mut first = Shared::from(vec![1, 2]);
        let second = first.clone();
        assert!(std::ptr::eq(&*first, &*second));
        first.push(3);
        assert_eq!((&*first, &*second), (&vec![1, 2, 3], &vec![1, 2]));
        let alone: *const Vec<i32> = &*first;
        first.push(4);
        assert!(std::ptr::eq(alone, &*first), "what nobody else holds is changed in place");
    }
}
