"""From a CAD file to a controller that is certified: every command of docs/story.md is run."""
