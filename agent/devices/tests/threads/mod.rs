mod clock;
mod guard;
mod reader;
mod sysfs;
