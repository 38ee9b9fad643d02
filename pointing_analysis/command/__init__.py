"""What commands share: options, opening of recordings, output, exit codes; and the command ``pointing-analysis``."""
