//! The window, driven without a screen by the names that a screen reader reads.

mod driver;
mod layout;
mod pages;
mod relighting;
