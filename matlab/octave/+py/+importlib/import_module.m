function import_module(name)
%IMPORT_MODULE  For GNU Octave: nothing. The module is run in a process of its own, see call.
end
