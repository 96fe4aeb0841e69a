//! The macros of utoipa that the sources name, without effect.
//!
//! The program serves the committed OpenAPI document. Only the generator, a feature, needs the output of utoipa for types and
//! handlers; without the feature these macros stand in for it, so that the attributes need no separate conditions.

use proc_macro::TokenStream;

/// Accepts the attributes of a schema.
#[proc_macro_derive(ToSchema, attributes(schema, serde))]
pub fn to_schema(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Accepts the attributes of parameters.
#[proc_macro_derive(IntoParams, attributes(into_params, param, serde))]
pub fn into_params(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Accepts the description of an operation.
#[proc_macro_attribute]
pub fn path(_: TokenStream, handler: TokenStream) -> TokenStream {
    handler
}
