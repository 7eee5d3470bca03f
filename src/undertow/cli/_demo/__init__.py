"""The story that `undertow demo` tells, on logs that come with the package."""
