//! Parameter structs whose documentation can be printed.
//!
//! A parameter's text is written once, as its doc comment: rustdoc shows it and `loopbox params`
//! prints it, so the two cannot drift apart.

/// A parameter or a table of parameters, as text.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// A plain value in TOML notation.
    Plain(String),
    /// A nested table.
    Table(Vec<DocumentedParameter>),
}

/// One documented parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct DocumentedParameter {
    /// Its key in a parameter file.
    pub name: &'static str,
    /// Its documentation, line by line, each with the blank that opens a doc comment.
    pub doc: Vec<&'static str>,
    /// Its default.
    pub default: ParameterValue,
}

/// What can stand as a parameter: plain values, and the structs made by `params!`.
pub trait Parameter {
    /// The value as text.
    fn value(&self) -> ParameterValue;

    /// The documented fields with their defaults, in order of definition; none for a plain value.
    fn documented() -> Vec<DocumentedParameter>
    where
        Self: Default,
    {
        match Self::default().value() {
            ParameterValue::Table(fields) => fields,
            ParameterValue::Plain(_) => Vec::new(),
        }
    }
}

macro_rules! plain_parameters {
    ($($type:ty),*) => {$(
        impl Parameter for $type {
            // Debug, not Display: TOML tells `1.0` from `1` and wants strings quoted.
            fn value(&self) -> ParameterValue {
                ParameterValue::Plain(format!("{self:?}"))
            }
        }
    )*};
}
plain_parameters!(bool, f32, f64, i32, i64, u8, u16, u32, u64, usize, String);

impl<T: Parameter, const N: usize> Parameter for [T; N] {
    fn value(&self) -> ParameterValue {
        let items: Vec<String> = self
            .iter()
            .map(|item| match item.value() {
                ParameterValue::Plain(text) => text,
                ParameterValue::Table(_) => unreachable!("parameters hold no arrays of tables"),
            })
            .collect();
        ParameterValue::Plain(format!("[{}]", items.join(", ")))
    }
}

/// Defines a parameter struct: every field has a doc comment and a default.
///
/// ```
/// use backend::{Parameter, params};
/// params! {
///     /// How a frame is aligned.
///     pub struct AlignParams {
///         /// Huber bound on the normalised residual, σ; 1–10. Lower trusts fewer pixels (Engel 2014, §3.3).
///         pub huber: f32 = 3.0,
///     }
/// }
/// assert_eq!(AlignParams::documented()[0].name, "huber");
/// ```
///
/// The struct is `Clone + Debug + PartialEq + Default`, reads with serde (missing keys take their
/// default, unknown keys are errors), and [`Parameter::documented`] lists its
/// fields. A field may be another such struct: `pub align: AlignParams = AlignParams::default()`.
/// `#[key = "name"]` before a field gives it another name in files than in the code: keys in users' files stay.
/// A crate that uses it needs `serde` among its dependencies.
#[macro_export]
macro_rules! params {
    (
        $(#[doc = $struct_doc:literal])+
        pub struct $name:ident {
            $( $(#[doc = $doc:literal])+ $(#[key = $key:literal])? pub $field:ident : $type:ty = $default:expr ),* $(,)?
        }
    ) => {
        $(#[doc = $struct_doc])+
        #[derive(Clone, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $(
                $(#[doc = $doc])+
                #[doc = ""]
                #[doc = concat!("Default: `", stringify!($default), "`.")]
                $(#[serde(rename = $key)])?
                pub $field: $type,
            )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default ),* }
            }
        }

        // Maps keep it among what they say of their run: by keys, as files have them.
        impl ::std::fmt::Debug for $name {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                f.debug_struct(stringify!($name))
                    $( .field([$( $key, )? stringify!($field)][0], &self.$field) )*
                    .finish()
            }
        }

        impl $crate::Parameter for $name {
            fn value(&self) -> $crate::ParameterValue {
                $crate::ParameterValue::Table(vec![
                    $( $crate::DocumentedParameter {
                        name: [$( $key, )? stringify!($field)][0],
                        doc: vec![$( $doc ),+],
                        default: $crate::Parameter::value(&self.$field),
                    } ),*
                ])
            }
        }
    };
}
#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use serde::de::value::{Error, MapDeserializer};

    params! {
        /// Inner.
        pub struct Inner {
            /// A share, 0–1.
            pub share: f32 = 1.0,
            /// Sizes.
            pub sizes: [u32; 2] = [3, 4],
        }
    }
    params! {
        /// Outer.
        pub struct Outer {
            /// How many.
            ///
            /// Second paragraph.
            pub count: usize = 7,
            /// The inner table.
            pub inner: Inner = Inner { share: 0.5, ..Inner::default() },
            /// Renamed.
            #[key = "old"]
            pub new: usize = 3,
        }
    }

    #[test]
    fn the_table_has_names_docs_and_defaults_in_order() {
        let table = Outer::documented();
        assert_eq!(table[0].name, "count");
        assert_eq!(table[0].doc, [" How many.", "", " Second paragraph."]);
        assert_eq!(table[0].default, ParameterValue::Plain("7".into()));
        let ParameterValue::Table(inner) = &table[1].default else { panic!("a nested struct is a table") };
        assert_eq!(inner[0].default, ParameterValue::Plain("0.5".into()));
        assert_eq!(inner[1].default, ParameterValue::Plain("[3, 4]".into()));
    }

    #[test]
    fn a_renamed_field_keeps_its_key() {
        assert_eq!(Outer::documented()[2].name, "old");
        let read = |key: &'static str| {
            Outer::deserialize(MapDeserializer::<_, Error>::new([(key, 5usize)].into_iter()))
        };
        assert_eq!(read("old").ok(), Some(Outer { new: 5, ..Outer::default() }));
        assert!(read("new").is_err(), "a file knows the key alone");
        let text = format!("{:?}", Outer::default());
        assert_eq!(text, "Outer { count: 7, inner: Inner { share: 0.5, sizes: [3, 4] }, old: 3 }");
    }

    #[test]
    fn the_default_is_the_written_one() {
        assert_eq!(Outer::default().inner, Inner { share: 0.5, sizes: [3, 4] });
    }
}
