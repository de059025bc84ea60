"""Every JSON file that the bench writes and reads again, as one model: a module for each, read and written only here.

| policy | of every record |
|---|---|
| missing | `read` raises InputError, `find` returns None |
| damaged, not an object, a wrong type | InputError with the file, the key, the value and what to do |
| of an older format | migrated on reading; a file without `format` is older than the first number |
| of a newer format | InputError: it may mean something else |
| keys that this bench does not know | kept, and written back |
| never said | not written: an optional key is absent until somebody gives it a value |
"""
