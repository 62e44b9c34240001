"""x"""
def write_summary(out, folds, config): pass
