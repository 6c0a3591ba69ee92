//! Groups of settings that a caller changes field by field.

/// Declares a group of numbers once, one row per setting: documentation, name, type, default.
///
/// The macro generates the group, and by [`changes`] the changes that a caller can make to it. `as` is the name of the changes'
/// schema in the description of the API.
macro_rules! group {
    (
        $(#[doc = $group_doc:tt])+
        $group:ident changed by $changes:ident as $schema:ident {
            $(
                $(#[doc = $doc:tt])+
                $(#[serde($($attribute:tt)+)])?
                $name:ident: $type:ident = $default:tt;
            )+
        }
    ) => {
        $(#[doc = $group_doc])+
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $group {
            $($(#[doc = $doc])+ $(#[serde($($attribute)+)])? pub $name: $type,)+
        }

        impl Default for $group {
            fn default() -> Self {
                Self { $($name: $default,)+ }
            }
        }

        $crate::training::group::changes! {
            $(#[doc = $group_doc])+
            $group changed by $changes as $schema {
                $($(#[doc = $doc])+ $(#[serde($($attribute)+)])? $name: $type = $default;)+
            }
        }
    };
}

/// Declares the changes that a caller can make to a group that exists already, one row per field of the group: documentation,
/// name, type, and the default in the description of the API where there is one.
macro_rules! changes {
    (
        $(#[doc = $group_doc:tt])+
        $group:ident changed by $changes:ident as $schema:ident {
            $(
                $(#[doc = $doc:tt])+
                $(#[serde($($attribute:tt)+)])?
                $name:ident: $type:ident $(= $default:tt)?;
            )+
        }
    ) => {
        $(#[doc = $group_doc])+
        ///
        /// Omitted fields keep the value of the preset or method.
        #[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
        #[schema(as = $schema)]
        #[serde(default, deny_unknown_fields)]
        pub struct $changes {
            $(
                $(#[doc = $doc])+
                $(#[serde($($attribute)+)])?
                #[serde(skip_serializing_if = "Option::is_none")]
                $(#[schema(value_type = $type, required = false, default = $default)])?
                pub $name: Option<$type>,
            )+
        }

        impl $changes {
            /// Sets the fields that are given.
            pub(crate) fn apply(&self, group: &mut $group) {
                $(if let Some(value) = self.$name {
                    group.$name = value.into();
                })+
            }

            /// Name, type and documentation of each field.
            pub(crate) fn declared() -> Vec<(&'static str, &'static str, &'static str)> {
                vec![$((stringify!($name), stringify!($type), concat!($($doc),+)),)+]
            }
        }

        impl From<$group> for $changes {
            fn from(group: $group) -> Self {
                Self { $($name: group.$name.into(),)+ }
            }
        }
    };
}

pub(crate) use {changes, group};
