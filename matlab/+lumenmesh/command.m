function text = command (varargin)
% COMMAND  Runs the command lumenmesh with some arguments; returns what it prints.
%   The environment variable LUMENMESH names the program where it is not on the path. An error has the program's own
%   words: file, frame, field, what was found and what was expected.
  program = getenv ('LUMENMESH');
  if isempty (program)
    program = 'lumenmesh';
  end
  line = quoted (program);
  for k = 1:numel (varargin)
    line = [line ' ' quoted(varargin{k})]; %#ok<AGROW>
  end
  errors = [tempname '.txt'];
  [status, text] = system ([line ' 2>' quoted(errors)]);
  said = '';
  if exist (errors, 'file')
    said = strtrim (fileread (errors));
    delete (errors);
  end
  if status ~= 0
    if isempty (said)
      said = sprintf ('cannot run %s (exit status %d)', program, status);
    end
    error ('lumenmesh:failed', '%s', said);
  end
end

function word = quoted (text)
  if ispc
    word = ['"' strrep(text, '"', '""') '"'];
  else
    word = ['''' strrep(text, '''', '''\''''') ''''];
  end
end
