"""The comparison as tables, figures and one offline page.  Plots only draw what the tables hold."""
