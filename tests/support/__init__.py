"""What several tests share: small scenes, arrays in memory, links, processes, terminals."""
