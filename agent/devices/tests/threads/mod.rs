mod clock;
mod guard;
mod reader;
