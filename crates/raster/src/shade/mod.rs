//! What surfaces look like: textures as they were scanned, and materials lit by a panorama.
//!
//! Everything is computed in linear light and written as sRGB (IEC 61966-2-1). A scanned scene is
//! *unlit*: its textures hold the light that fell on it. A drone is lit by an environment map
//! (image-based light): the cosine-weighted mean of the map for what scatters, and the map blurred
//! by the GGX distribution for what mirrors, by the split sum of Karis ("Real Shading in Unreal
//! Engine 4", SIGGRAPH 2013 course). [`appearance`](crate::gbuffer::appearance) draws both with one
//! z-buffer, so each hides the other.

pub mod environment;
mod ggx;
pub mod material;
pub mod srgb;
pub mod texture;

pub use self::environment::Environment;
pub use self::material::{Light, Look, Material, Materials, Paint};
pub use self::texture::Texture;
