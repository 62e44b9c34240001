"""Style transfer of whole clips (Holden 2016, 2017)."""
