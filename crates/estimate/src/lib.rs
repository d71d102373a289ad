//! From photographs to light and roughness: whether the capture fits together, where mesh and cameras belong, and the estimate itself.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_capture::Capture;
//! use rekindle_estimate::align::{Start, align};
//!
//! let (capture, _) = Capture::load_unplaced("capture".as_ref())?;
//! let found = align(&capture.views, &capture.mesh, Start::Anywhere, &mut |_| (), &|| false)?;
//! println!("{:?}", found.transform.matrix());
//! # Ok(())
//! # }
//! ```

pub mod align;
pub mod estimate;
pub mod preflight;
pub mod registration;
